"""The benchmarks of optimisers in their quick versions, and the peers behind our protocol."""

import math
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from torch import Tensor

from benchmarks.__main__ import main
from benchmarks.optimiser_problems import real_photographs
from benchmarks.paper_experiment import spread_of
from cloudfit.optimisers.base import Budget, Minimiser, StopReason
from render.errors import ParameterError
from tests.support.comparison import make_run
from tests.system.test_benchmarks import run_quick

pytest.importorskip("cma", reason="needs the extra bench")

from benchmarks.optimiser_peers import PEERS, PycmaMinimiser, ScipyDifferentialEvolution
from benchmarks.optimisers import QUICK_METHODS, choose


@pytest.fixture(autouse=True)
def _same_threads() -> Iterator[None]:
    """Benchmarks set the number of threads of their process; put it back."""
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


def valley(population: Tensor) -> Tensor:
    """Smooth, its minimum of 0 inside the cube, narrow in one direction."""
    x = population.double() - 0.37
    return x[:, 0].square() + 30.0 * (x[:, 1:] - x[:, :1].square()).square().sum(1)


def test_optimisers_are_compared_with_peers_on_the_same_problems(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = ("--threads", "1", "--out", str(tmp_path / "out"))
    result, out = run_quick("optimisers", tmp_path, capsys, *place)
    assert {row["method"] for row in result["methods"]} == set(QUICK_METHODS)
    assert all(row["runs"] == 4 and row["failed"] == 0 for row in result["methods"])
    assert all(problem["truth_loss"] > 0.0 for problem in result["problems"])
    assert result["machine"]["versions"]["cma"]
    assert "scipy_de_generations" in out
    assert (tmp_path / "out" / "index.html").is_file()
    again, _ = run_quick("optimisers", tmp_path, capsys, *place)
    assert again["methods"] == result["methods"], "nothing was run again"


def test_the_papers_experiment_has_mean_deviation_and_pictures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    place = ("--threads", "1", "--out", str(tmp_path / "out"))
    methods = ("--methods", "genetic_paper", "nelder_mead")
    result, out = run_quick("paper_experiment", tmp_path, capsys, *place, *methods)
    genetic, other = result["spreads"]
    assert (genetic["method"], genetic["runs"], genetic["paper"]) == ("genetic_paper", 3, [0.4, 0.01])
    assert other["paper"] is None
    assert 0.0 < genetic["smallest"] <= genetic["mean"] <= genetic["largest"] < 2.0
    assert genetic["deviation"] > 0.0
    assert (tmp_path / "out" / "pictures" / "nelder_mead-worst.png").is_file()
    assert "0.40 / 0.01" in out


def test_the_spread_of_runs_by_hand() -> None:
    runs = [make_run(seed=n, steps=((1, 0.1, loss),)) for n, loss in enumerate((1.0, 2.0, 6.0))]
    runs.append(make_run(seed=3, steps=((1, 0.1, 100.0),), failed=True))
    spread = spread_of("a", runs)
    assert (spread.runs, spread.mean, spread.smallest, spread.largest) == (3, 3.0, 1.0, 6.0)
    assert spread.deviation == pytest.approx(math.sqrt((4.0 + 1.0 + 9.0) / 2.0))
    with pytest.raises(ParameterError, match="two runs"):
        spread_of("a", runs[:1])


@pytest.mark.parametrize("name", PEERS)
class TestPeers:
    def test_the_minimum_is_found(self, name: str) -> None:
        result = PEERS[name].minimise(valley, 3, Budget(3000), 1)
        assert result.best_loss < 1e-4
        assert bool(((result.evaluated >= 0.0) & (result.evaluated <= 1.0)).all())

    def test_the_budget_is_kept_to_the_evaluation(self, name: str) -> None:
        result = PEERS[name].minimise(valley, 3, Budget(101), 1)
        assert result.evaluations == 101
        assert result.stop_reason is StopReason.EVALUATIONS
        assert PEERS[name].minimise(valley, 3, Budget(3000, None, 0.5), 1).stop_reason is StopReason.TARGET

    def test_equal_seeds_give_equal_runs_and_others_do_not(self, name: str) -> None:
        first, again, other = (PEERS[name].minimise(valley, 3, Budget(200), seed) for seed in (0, 0, 1))
        assert torch.equal(first.evaluated, again.evaluated)
        assert not torch.equal(first.evaluated, other.evaluated)

    def test_losses_that_are_no_numbers_and_errors_are_survived(self, name: str) -> None:
        def rough(population: Tensor) -> Tensor:
            return torch.where(population[:, 0] > 0.5, torch.nan, valley(population))

        assert PEERS[name].minimise(rough, 3, Budget(600), 1).best_loss < 0.1
        calls = []

        def breaking(population: Tensor) -> Tensor:
            calls.append(len(population))
            if len(calls) > 3:
                raise ArithmeticError("over")
            return valley(population)

        failed = PEERS[name].minimise(breaking, 3, Budget(600), 1)
        assert failed.stop_reason is StopReason.FAILED
        assert "over" in failed.message


def test_scipy_and_pycma_end_of_themselves_and_ipop_does_not() -> None:
    ended: list[Minimiser] = [PycmaMinimiser(), ScipyDifferentialEvolution()]
    for peer in ended:
        assert peer.minimise(valley, 2, Budget(20_000), 0).stop_reason is StopReason.CONVERGED
    endless = PycmaMinimiser(growth=2.0).minimise(valley, 2, Budget(4000), 0)
    assert endless.stop_reason is StopReason.EVALUATIONS


def test_numbers_outside_their_domain_and_unknown_names_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(ParameterError, match="growth"):
        PycmaMinimiser(growth=0.5)
    with pytest.raises(ParameterError, match="pycma"):
        choose(["best"])
    assert main(["paper_experiment", "--quick", "--methods", "best"]) == 3
    assert "best" in capsys.readouterr().err


def test_photographs_come_from_a_folder(tmp_path: Path) -> None:
    for name in ("b.png", "a.jpg", "c.txt"):
        (tmp_path / name).touch()
    assert [path.name for path in real_photographs(tmp_path, 1)] == ["a.jpg"]
