"""The fused look-up is the one in torch."""

import pytest
import torch

pytest.importorskip("numba")

from render.fused import torch_loops_only
from render.random_streams import child_generator
from render.shafts import fused_froxel_volume
from render.shafts.froxel_volume import accumulate_froxels, look_up_froxels
from tests.unit.render.shafts.test_froxel_volume import draw_volume


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("thickness", [0.0, 1e-9, 1.0, 300.0])
def test_it_finds_what_torch_finds(channels: int, thickness: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fused_froxel_volume, "PIXELS", 77)
    edges, source, extinction = draw_volume(9, seed=1)
    volume = accumulate_froxels(edges, source, thickness * extinction[..., :channels])
    generator = child_generator(2)
    columns, rows, distance = torch.rand(3, 1000, generator=generator) * torch.tensor([[7.0], [6.0], [9.0]]) - 1.0
    distance = torch.where(distance < 0.0, torch.inf, distance)
    distance[:100] = edges[torch.arange(100) % len(edges)]
    columns[50:150] = columns[50:150].round() + 0.5
    found = look_up_froxels(volume, columns, rows, distance)
    with torch_loops_only():
        expected = look_up_froxels(volume, columns, rows, distance)
        other = look_up_froxels(volume, columns, rows + 0.5, distance)
    for mine, theirs in zip(found, expected, strict=True):
        torch.testing.assert_close(mine, theirs, rtol=1e-5, atol=1e-6)
    assert not torch.allclose(found[0], other[0], atol=1e-3)
