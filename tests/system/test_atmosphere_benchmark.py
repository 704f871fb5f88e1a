"""The benchmark of the atmosphere runs in its quick version, and its truth and errors are what they say."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from benchmarks import atmosphere
from benchmarks.__main__ import main
from benchmarks.atmosphere import Truth, make_truth
from render.atmosphere.earth import earth
from tests.support.shared_data import shared_file


@pytest.fixture(autouse=True)
def _same_threads() -> Iterator[None]:
    """Benchmarks set the number of threads of their process; put it back."""
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


def test_both_modes_are_timed_beside_their_errors(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(atmosphere, "FOLDER", tmp_path / "absent")
    file = tmp_path / "result.json"
    assert main(["atmosphere", "--quick", "--threads", "1", "--json", str(file)]) == 0
    result = json.loads(file.read_text())
    modes = {one["name"]: one for one in result["measured"]}
    assert set(modes) == {"parity", "accurate x 0.2"}
    for one in modes.values():
        assert one["seconds"] == pytest.approx(sum(one["stages"].values()))
        assert {"order 2", "order 3"} <= set(one["stages"])
        assert one["ray_us"] > 0.0
        assert one["table_mb"] > 0.0
    accurate, parity = (modes[name]["errors"]["once"] for name in ("accurate x 0.2", "parity"))
    assert accurate["median"] < 0.01
    assert parity["median"] > accurate["median"]
    assert result["parity"] is None
    assert "accurate x 0.2" in capsys.readouterr().out


def test_the_truth_is_the_same_for_the_same_seed_and_errors_are_relative() -> None:
    planet = earth((550e-9,))
    first, second = (make_truth(planet, 5, 3, 2, seed) for seed in (1, 2))
    again = make_truth(planet, 5, 3, 2, 1)
    torch.testing.assert_close(first.often, again.often)
    assert not torch.allclose(first.view, second.view)
    one = torch.ones(4, 1, dtype=torch.float64)
    truth = Truth(one, one, one, one, 3.0 * one, one)
    errors = truth.errors(1.1 * one, 3.0 * one)
    assert errors["once"]["median"] == pytest.approx(0.1)
    assert errors["often"]["p95"] == 0.0
    assert errors["whole"]["bias"] == pytest.approx(0.1 / 4.0)


@pytest.mark.slow
def test_parity_errors_are_those_of_rounding() -> None:
    shared_file("golden/bruneton/textures_small.npz")
    errors = atmosphere.parity_errors()
    assert max(errors.values()) < 1e-7
    assert max(errors.values()) > 0.0
