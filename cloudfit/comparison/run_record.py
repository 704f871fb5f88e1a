"""One run of one method on one problem from one seed: what is kept of it, and the file that keeps it."""

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from render.atomic_write import atomic_path
from render.errors import ResultError

SCHEMA = "cloudfit comparison run 1"

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Trace:
    """The evaluations that improved the best loss, in order; between two of them the best loss is that of the first.

    Args:
        evaluation: numbers of the evaluations, from 1, increasing `(improvement,)`.
        seconds: since the start of the run at which the loss was known `(improvement,)` [s].
        loss: decreasing `(improvement,)`.

    Raises:
        ResultError: when the three do not belong together.
    """

    evaluation: Floats
    seconds: Floats
    loss: Floats

    def __post_init__(self) -> None:
        lengths = {len(self.evaluation), len(self.seconds), len(self.loss)}
        orderly = (
            len(lengths) == 1
            and np.all(np.diff(self.evaluation) > 0)
            and np.all(np.diff(self.seconds) >= 0)
            and np.all(np.diff(self.loss) < 0)
        )
        if not orderly or (len(self.evaluation) and self.evaluation[0] != 1):
            raise ResultError("expected a trace that begins with evaluation 1 and falls with every entry")

    @classmethod
    def of_losses(cls, losses: Floats, seconds: Floats) -> "Trace":
        """The improvements among the losses of all evaluations `(evaluation,)`, known at the given seconds `(evaluation,)`."""
        before = np.concatenate([[math.inf], np.minimum.accumulate(losses)[:-1]])
        better = np.flatnonzero(losses < before)
        return cls((better + 1).astype(np.float64), seconds[better], losses[better])

    def evaluations_until(self, target: float) -> float:
        """Number of evaluations until a loss of at most the target was found, or infinity."""
        reached = np.flatnonzero(self.loss <= target)
        return float(self.evaluation[reached[0]]) if len(reached) else math.inf

    def seconds_until(self, target: float) -> float:
        """Seconds until a loss of at most the target was known, or infinity."""
        reached = np.flatnonzero(self.loss <= target)
        return float(self.seconds[reached[0]]) if len(reached) else math.inf

    def best_at(self, times: Floats | float, clock: Floats) -> Floats:
        """Best loss at readings, of any shape, of `self.evaluation` or `self.seconds`; infinite before the first."""
        losses = np.concatenate([[math.inf], self.loss])
        return losses[np.searchsorted(clock, times, side="right")]


@dataclass(frozen=True, eq=False)
class RunRecord:
    """What became of a run.

    Args:
        fingerprint: of everything that the run depends on.
        problem, method, seed: which run.
        failed: whether the method failed; what it had found by then is kept.
        message: what went wrong, else why it ended.
        starts: times that the method was started, the first included.
        evaluations: number of points evaluated.
        seconds: duration of the run [s]: of the processor where it had one thread, else by the wall.
        objective_seconds: part of it inside the objective [s]; the rest is the overhead of the method.
        best: best point in the unit cube `(parameter,)`; empty if nothing was evaluated.
        parameters: the same by name, in units.
        loss: of the best point, computed once more after the run; infinite if nothing was evaluated.
        threads: of the process.
        trace: the improvements.
        refused: whether the method did not take the problem at all, such as one that needs gradients where there are none.
    """

    fingerprint: str
    problem: str
    method: str
    seed: int
    failed: bool
    message: str
    starts: int
    evaluations: int
    seconds: float
    objective_seconds: float
    best: tuple[float, ...]
    parameters: dict[str, float]
    loss: float
    threads: int
    trace: Trace
    refused: bool = False

    @property
    def overhead_seconds(self) -> float:
        """Time of the method itself [s]."""
        return max(0.0, self.seconds - self.objective_seconds)


def write_run(path: Path, record: RunRecord) -> None:
    """Write a run; the file appears whole or not at all."""
    document = {"schema": SCHEMA, **asdict(record)}
    document["loss"] = record.loss if math.isfinite(record.loss) else None
    document["trace"] = {name: values.tolist() for name, values in vars(record.trace).items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(document, allow_nan=False) + "\n", encoding="utf-8")


def read_run(path: Path) -> RunRecord:
    """Read what `write_run` wrote.

    Raises:
        ResultError: there is no such file, or it holds something else.
    """
    try:
        document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if document.pop("schema") != SCHEMA:
            raise ResultError(f"{path}: expected a run of a comparison ({SCHEMA})")
        trace = Trace(*(np.array(document["trace"][name], float) for name in ("evaluation", "seconds", "loss")))
        loss = math.inf if document["loss"] is None else float(document["loss"])
        best = tuple(float(value) for value in document["best"])
        return RunRecord(**{**document, "trace": trace, "loss": loss, "best": best})
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ResultError(f"{path}: no readable run of a comparison: {type(error).__name__} {error}") from error


def kept_run(path: Path, fingerprint: str) -> RunRecord | None:
    """The run of an earlier call that answers just this question, or None."""
    try:
        record = read_run(path)
    except ResultError:
        return None
    return record if record.fingerprint == fingerprint else None
