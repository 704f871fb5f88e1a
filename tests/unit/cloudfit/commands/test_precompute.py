import json
from pathlib import Path
from typing import Any

import pytest
import torch

from cloudfit import stack as stack_module
from cloudfit.commands.precompute import precompute
from cloudfit.parameters import LARGEST_OPTICAL_DEPTH_RANGE
from cloudfit.quality import QUALITIES, quality_for
from precompute.stack_store import StackReport
from render.density_grid import DensityGrid
from render.scattering_stack import ScatteringStack
from render.volume_files import write_volume
from tests.support.fake_stages import one_pixel_tables


def test_the_store_is_filled_and_its_place_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    calls: list[tuple[Any, ...]] = []

    def stand_in(*arguments: Any) -> tuple[ScatteringStack, StackReport]:
        calls.append(arguments)
        return ScatteringStack(one_pixel_tables()), StackReport(1.5, False, tmp_path / "stack.safetensors")

    monkeypatch.setattr(stack_module, "prepare_stack", stand_in)
    write_volume(tmp_path / "cloud.npz", DensityGrid.from_voxel_size(torch.ones(3, 3, 3), 10.0))
    precompute(tmp_path / "cloud.npz", tmp_path / "tables", camera_width=8, camera_height=6, seed=4)
    scene, quality, seed, folder, _, depths = calls[0]
    assert (scene.camera.width, quality, seed, folder) == (8, QUALITIES["standard"], 4, tmp_path / "tables")
    assert depths == LARGEST_OPTICAL_DEPTH_RANGE
    streams = capsys.readouterr()
    assert streams.out.strip() == str(tmp_path / "stack.safetensors")
    assert "built in 1.5 s; 100% of the nodes" in streams.err
    precompute(
        tmp_path / "cloud.npz",
        tmp_path / "tables",
        tolerance=0.03,
        max_seconds=9.0,
        optical_depths=(0.1, 2.0),
        json=True,
    )
    assert calls[1][1] == quality_for(0.03).limited(9.0)
    assert calls[1][5] == (0.1, 2.0)
    assert json.loads(capsys.readouterr().out)["usable_nodes"] == 1.0
