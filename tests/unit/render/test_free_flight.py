"""Free flights: where a given optical length is used up, in closed form and by integrating along the way."""

import math

import pytest
import torch

from render import free_flight
from render.density_grid import DensityGrid
from render.free_flight import DARKEST_DEPTH, Flight, fly, march_to_sun
from render.ray_march import compute_optical_length
from tests.support.statistics import passes_z_test
from tests.support.volumes import noise_box, ramp_box, random_rays, scaled, towards, uniform_box

pytestmark = pytest.mark.usefixtures("loops")

EAST = torch.tensor([[1.0, 0.0, 0.0]])


def starts_inside(grid: DensityGrid, count: int, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    position = grid.lower + torch.rand(count, 3, generator=generator) * (grid.upper - grid.lower)
    return position, torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=-1)


def length_on_the_way(grid: DensityGrid, start: torch.Tensor, end: torch.Tensor, samples: int = 2000) -> torch.Tensor:
    """Integral of the density between points, by midpoints."""
    share = ((torch.arange(samples) + 0.5) / samples)[:, None]
    points = start[:, None] + share * (end - start)[:, None]
    return grid.look_up_density(points).double().mean(1) * (end - start).norm(dim=-1)


def test_a_uniform_box_is_left_or_passed_by_the_exact_distance() -> None:
    grid = uniform_box(density=0.5)
    position, direction = starts_inside(grid, 500)
    target = 2.0 * torch.rand(500, generator=torch.Generator().manual_seed(1))
    _, far = grid.intersect(position, direction)
    flight = fly(grid, position, direction, target, 1.0)
    assert torch.equal(flight.collided, target / 0.5 < far)
    assert 100 < int(flight.collided.sum()) < 400
    ended = flight.collided
    expected = position + (target / 0.5)[:, None] * direction
    torch.testing.assert_close(flight.position[ended], expected[ended], atol=1e-5, rtol=0.0)
    assert torch.equal(flight.optical_length[ended], target[ended])
    torch.testing.assert_close(flight.optical_length[~ended], 0.5 * far[~ended], atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("step", [0.25, 1.0, 1.7])
def test_a_ramp_is_solved_exactly_in_both_directions(step: float) -> None:
    grid = ramp_box()
    start = torch.tensor([1.0, 0.1, 0.2])
    target = torch.linspace(0.0, 5.0, 30)
    flight = fly(grid, start.expand(30, 3), EAST.expand(30, 3), target, step)
    # From x = 1 the optical length is (x^2 - 1)/8.
    expected = (1.0 + 8.0 * target).sqrt()
    torch.testing.assert_close(flight.position[:, 0], expected, atol=2e-3 if step > 1.0 else 1e-4, rtol=0.0)
    back = fly(grid, torch.tensor([[7.0, 0.1, 0.2]]).expand(30, 3), -EAST.expand(30, 3), target, step)
    torch.testing.assert_close(
        back.position[:, 0], (49.0 - 8.0 * target).sqrt(), atol=2e-3 if step > 1.0 else 1e-4, rtol=0.0
    )
    assert flight.collided.all()
    assert back.collided.all()


def test_a_step_that_starts_without_density_is_solved() -> None:
    grid = DensityGrid(torch.tensor([0.0, 1.0]).reshape(1, 1, 2), torch.zeros(3), torch.tensor([2.0, 1.0, 1.0]))
    start, target = torch.tensor([[0.5, 0.5, 0.5]]), torch.tensor([0.08])
    flight = fly(grid, start, EAST, target, 0.5)
    assert float(flight.position[0, 0]) == pytest.approx(0.5 + math.sqrt(0.16), rel=1e-5)


@pytest.mark.parametrize("step", [0.05, 0.25])
def test_the_length_passed_is_the_target(step: float) -> None:
    grid = noise_box(sparse=0.4)
    position, direction = starts_inside(grid, 300)
    target = torch.empty(300).exponential_(generator=torch.Generator().manual_seed(1))
    flight = fly(grid, position, direction, target, step)
    ended = flight.collided
    passed = length_on_the_way(grid, position[ended], flight.position[ended])
    torch.testing.assert_close(passed.float(), target[ended], rtol=0.0, atol=4.0 * step**2 / 10.0 + 1e-3)
    assert not torch.allclose(passed.float(), 1.2 * target[ended], rtol=0.0, atol=0.1)


def test_infinity_measures_the_chord() -> None:
    grid = noise_box()
    origin, direction = random_rays(grid, 200)
    flight = fly(grid, origin, direction, torch.full((200,), torch.inf), 0.02)
    assert not flight.collided.any()
    torch.testing.assert_close(
        flight.optical_length, compute_optical_length(grid, origin, direction, 0.02), rtol=1e-3, atol=1e-4
    )
    near, _ = grid.intersect(origin, direction)
    torch.testing.assert_close(flight.position, origin + near[:, None] * direction)


def test_flights_that_start_outside_enter_first() -> None:
    grid = uniform_box()
    start = torch.tensor([[-5.0, 0.0, 0.0], [-5.0, 9.0, 0.0], [5.0, 0.0, 0.0]])
    flight = fly(grid, start, EAST.expand(3, 3), torch.full((3,), 1.5), 1.0)
    assert flight.collided.tolist() == [True, False, False]
    assert flight.optical_length.tolist() == [1.5, 0.0, 0.0]
    assert flight.position[0].tolist() == pytest.approx([-0.5, 0.0, 0.0])


def test_nothing_to_use_up_ends_at_once_where_there_is_density() -> None:
    grid = uniform_box()
    flight = fly(grid, torch.zeros(1, 3), EAST, torch.zeros(1), 1.0)
    assert flight.collided.item() is True
    torch.testing.assert_close(flight.position, torch.zeros(1, 3))
    empty = DensityGrid.from_voxel_size(torch.zeros(3, 3, 3), 1.0)
    assert fly(empty, torch.zeros(1, 3), EAST, torch.zeros(1), 1.0).collided.item() is False
    assert fly(empty, torch.zeros(0, 3), EAST[:0], torch.zeros(0), 1.0).collided.shape == (0,)


def flights(grid: DensityGrid, factor: float = 1.0) -> Flight:
    position, direction = starts_inside(noise_box(12), 400)
    target = 2.0 * torch.empty(400).exponential_(generator=torch.Generator().manual_seed(1))
    return fly(grid, factor * position, direction, factor * target, 0.25)


@pytest.mark.parametrize("block", [1, 3, 1000])
def test_blocks_are_no_part_of_the_result(block: int, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = flights(noise_box(12))
    monkeypatch.setattr(free_flight, "BLOCK", block)
    found = flights(noise_box(12))
    assert torch.equal(found.collided, expected.collided)
    torch.testing.assert_close(found.position, expected.position, atol=1e-4, rtol=0.0)
    torch.testing.assert_close(found.optical_length, expected.optical_length, atol=1e-4, rtol=1e-5)


def test_flights_have_no_scale() -> None:
    small, large = flights(noise_box(12)), flights(scaled(noise_box(12), 1024.0), 1024.0)
    assert torch.equal(small.collided, large.collided)
    torch.testing.assert_close(large.position, 1024.0 * small.position)
    torch.testing.assert_close(large.optical_length, 1024.0 * small.optical_length)


def test_exponential_lengths_collide_as_often_as_light_is_extinguished() -> None:
    grid = noise_box()
    origin, direction = random_rays(grid, 20)
    target = torch.empty(20, 2000).exponential_(generator=torch.Generator().manual_seed(2)) / 0.7
    flight = fly(
        grid,
        origin.repeat_interleave(2000, 0),
        direction.repeat_interleave(2000, 0),
        target.flatten(),
        0.1,
    )
    share = flight.collided.reshape(20, 2000).double().mean(1)
    length = compute_optical_length(grid, origin, direction, 0.1).double()
    for extinction, right in ((0.7, True), (0.8, False)):
        opacity = 1.0 - torch.exp(-extinction * length)
        assert passes_z_test(share - opacity, opacity * (1.0 - opacity) / 2000) is right


def test_the_way_to_the_sun_is_measured_as_far_as_light_reaches() -> None:
    grid = uniform_box()
    points = torch.tensor([[0.0, 0.0, 2.0], [0.0, 0.0, -2.0], [0.0, 0.0, 4.0]])
    zenith = towards(0.0, 90.0)
    torch.testing.assert_close(
        march_to_sun(grid, points, zenith, torch.tensor(1.0), 1.0), torch.tensor([1.0, 5.0, 0.0])
    )
    torch.testing.assert_close(
        march_to_sun(grid, points, -zenith, torch.tensor(1.0), 1.0), torch.tensor([5.0, 1.0, 6.0])
    )
    thick = torch.tensor(10.0)
    torch.testing.assert_close(
        march_to_sun(grid, points, zenith, thick, 1.0), torch.tensor([1.0, DARKEST_DEPTH / 10.0, 0.0])
    )
