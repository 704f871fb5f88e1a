"""The fused march is the one in torch: same collisions, places and lengths, whatever the volume, the step or the threads."""

from collections.abc import Callable

import pytest
import torch

pytest.importorskip("numba")

from render import fused_flight
from render.density_grid import DensityGrid
from render.free_flight import Flight, fly, march_to_sun
from render.fused import fused_loops_wanted, torch_loops_only
from tests.support.volumes import noise_box, ramp_box, towards, uniform_box

pytestmark = pytest.mark.skipif(not fused_loops_wanted(), reason="the fused loops are turned off")


def islands() -> DensityGrid:
    """Two small clouds at opposite corners of an empty box, over which marches leap; its voxels are no cubes."""
    density = torch.zeros(20, 14, 24)
    density[1:7, 1:8, 2:9] = noise_box().density.repeat(1, 2, 2)[:, :7, :7]
    density[15:19, 9:13, 18:24] = noise_box(seed=2).density[:4, :4, :6]
    return DensityGrid.from_voxel_size(60.0 * density, (0.3, 0.5, 0.2))


GRIDS: dict[str, Callable[[], DensityGrid]] = {
    "noise": noise_box,
    "holes": lambda: noise_box(8, sparse=0.7),
    "islands": islands,
    "ramp": ramp_box,
    "one voxel": lambda: uniform_box(voxels=(1, 1, 1)),
    "one voxel thick": lambda: uniform_box(voxels=(5, 1, 7), density=0.3),
    "one column": lambda: DensityGrid.from_voxel_size(torch.linspace(0.0, 1.0, 9).reshape(9, 1, 1), (1.0, 2.0, 0.5)),
    "empty": lambda: DensityGrid.from_voxel_size(torch.zeros(3, 4, 5), 1.0),
    "thick": lambda: DensityGrid.from_voxel_size(500.0 * noise_box().density, 1.0),
}


def starts(grid: DensityGrid, count: int = 600) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Positions in the box and around it, directions, a few along the axes, and lengths to use up, some infinite."""
    generator = torch.Generator().manual_seed(0)
    extent = grid.upper - grid.lower
    position = grid.lower + (1.5 * torch.rand(count, 3, generator=generator) - 0.25) * extent
    direction = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=-1)
    direction[:60] = torch.eye(3).repeat(20, 1) * (1.0 - 2.0 * (torch.arange(60) % 2))[:, None]
    target = torch.empty(count).exponential_(generator=generator) * 2.0
    target[::10] = torch.inf
    target[5::50] = 0.0
    return position, direction, target


def both(grid: DensityGrid, step: float) -> tuple[Flight, Flight]:
    arguments = starts(grid)
    with torch_loops_only():
        plain = fly(grid, *arguments, step)
    return fly(grid, *arguments, step), plain


@pytest.mark.parametrize("step", [0.25, 1.0])
@pytest.mark.parametrize("name", GRIDS)
def test_flights_are_those_of_torch(name: str, step: float) -> None:
    grid = GRIDS[name]()
    fused, plain = both(grid, step)
    # A length that ends just where the volume does may fall on either side by rounding.
    same = fused.collided == plain.collided
    assert int((~same).sum()) <= 1
    scale = float((grid.upper - grid.lower).max())
    torch.testing.assert_close(fused.position[same], plain.position[same], rtol=1e-5, atol=1e-4 * scale)
    torch.testing.assert_close(fused.optical_length[same], plain.optical_length[same], rtol=1e-5, atol=1e-5)
    if name not in ("empty",):
        assert 0.05 < float(fused.collided.float().mean()) < 0.95


@pytest.mark.parametrize("step", [0.1, 0.7, 3.0])
def test_leaps_over_nothing_change_nothing(step: float) -> None:
    grid, steps_only = islands(), islands()
    vars(steps_only.table)["clearance"] = torch.zeros_like(grid.table.clearance)
    assert int(grid.table.clearance.max()) >= 5
    leaping, stepping = (fly(one, *starts(grid, 4000), step) for one in (grid, steps_only))
    assert torch.equal(leaping.collided, stepping.collided)
    assert torch.equal(leaping.position, stepping.position)
    assert torch.equal(leaping.optical_length, stepping.optical_length)


def test_other_lengths_end_elsewhere() -> None:
    grid = noise_box()
    position, direction, target = starts(grid)
    with torch_loops_only():
        plain = fly(grid, position, direction, 1.01 * target, 0.25)
    fused = fly(grid, position, direction, target, 0.25)
    both_ended = fused.collided & plain.collided & (target > 0.1)
    assert not torch.allclose(fused.position[both_ended], plain.position[both_ended], rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("name", GRIDS)
@pytest.mark.parametrize("extinction", [0.1, 50.0])
def test_the_way_to_the_sun_is_that_of_torch(name: str, extinction: float) -> None:
    grid, sun = GRIDS[name](), towards(120.0, 30.0)
    position = starts(grid)[0]
    with torch_loops_only():
        plain = march_to_sun(grid, position, sun, torch.tensor(extinction), 0.5)
    torch.testing.assert_close(
        march_to_sun(grid, position, sun, torch.tensor(extinction), 0.5), plain, rtol=1e-5, atol=1e-5
    )


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("chunk", [1, 100, 1 << 20])
def test_threads_and_chunks_are_no_part_of_the_result(
    threads: int, chunk: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = starts(noise_box())
    expected = fly(noise_box(), *arguments, 0.5)
    monkeypatch.setattr(fused_flight, "CHUNK", chunk)
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        found = fly(noise_box(), *arguments, 0.5)
    finally:
        torch.set_num_threads(before)
    assert torch.equal(found.collided, expected.collided)
    assert torch.equal(found.position, expected.position)
    assert torch.equal(found.optical_length, expected.optical_length)


def test_no_rays_have_no_flights() -> None:
    assert fly(noise_box(), torch.zeros(0, 3), torch.zeros(0, 3), torch.zeros(0), 0.5).position.shape == (0, 3)
