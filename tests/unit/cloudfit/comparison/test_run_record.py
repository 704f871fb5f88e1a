import json
import math
from pathlib import Path

import numpy as np
import pytest

from cloudfit.comparison.run_record import Trace, kept_run, read_run, write_run
from render.errors import ResultError
from tests.support.comparison import make_run, trace


def test_only_improvements_are_kept_of_the_losses() -> None:
    found = Trace.of_losses(np.array([3.0, 3.0, 2.0, 5.0, 1.0]), np.array([0.1, 0.2, 0.2, 0.4, 0.5]))
    assert found.evaluation.tolist() == [1, 3, 5]
    assert found.seconds.tolist() == [0.1, 0.2, 0.5]
    assert found.loss.tolist() == [3.0, 2.0, 1.0]
    assert len(Trace.of_losses(np.empty(0), np.empty(0)).loss) == 0


def test_times_until_a_loss_and_losses_at_a_time() -> None:
    steps = trace((1, 0.5, 3.0), (4, 2.0, 1.0))
    assert steps.evaluations_until(3.0) == 1
    assert steps.evaluations_until(2.9) == 4
    assert steps.seconds_until(1.0) == 2.0
    assert steps.seconds_until(0.9) == math.inf
    assert steps.best_at(3.99, steps.evaluation) == 3.0
    assert steps.best_at(4, steps.evaluation) == 1.0
    assert steps.best_at(0.4, steps.seconds) == math.inf


@pytest.mark.parametrize(
    "steps",
    [
        ((2, 0.1, 1.0),),
        ((1, 0.1, 1.0), (1, 0.2, 0.5)),
        ((1, 0.2, 1.0), (2, 0.1, 0.5)),
        ((1, 0.1, 1.0), (2, 0.2, 1.0)),
    ],
)
def test_a_trace_that_is_none_is_refused(steps: tuple[tuple[float, float, float], ...]) -> None:
    with pytest.raises(ResultError, match="evaluation 1"):
        trace(*steps)


def test_a_run_survives_its_file(tmp_path: Path) -> None:
    record = make_run(steps=((1, 0.25, 1.0), (7, 0.5, 0.125)))
    write_run(tmp_path / "deep" / "run.json", record)
    again = read_run(tmp_path / "deep" / "run.json")
    assert (again.loss, again.best, again.parameters) == (0.125, (0.25, 0.5), {"x": 0.5, "y": 0.5})
    assert again.trace.evaluation.tolist() == [1, 7]
    assert again.overhead_seconds == pytest.approx(2.5)
    write_run(tmp_path / "nothing.json", make_run(steps=()))
    assert read_run(tmp_path / "nothing.json").loss == math.inf


def test_only_a_run_that_answers_the_question_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    assert kept_run(path, "f") is None
    write_run(path, make_run())
    assert kept_run(path, "f") is not None
    assert kept_run(path, "g") is None
    path.write_text(path.read_text()[:50])
    assert kept_run(path, "f") is None
    path.write_text(json.dumps({"schema": "something else"}))
    with pytest.raises(ResultError, match="expected a run"):
        read_run(path)
