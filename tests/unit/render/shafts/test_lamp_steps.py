import math

import pytest
import torch

from render.errors import ParameterError
from render.shafts.lamp_steps import (
    angles_at_lamp,
    brightest_places,
    distances_at_angles,
    edges_towards_lamp,
    find_closest,
    inverse_square_mean,
)
from render.shafts.rays import ViewRays

LAMP, RADIUS = (60.0, 1.0, 0.0), 0.1


def two_rays() -> ViewRays:
    """One that passes the lamp at 1 m and one that leads away from it."""
    return ViewRays(torch.zeros(2, 3), torch.tensor([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]]), torch.tensor([100.0, 10.0]))


def test_where_a_ray_passes_a_lamp() -> None:
    nearest, aside = find_closest(two_rays(), LAMP, RADIUS)
    torch.testing.assert_close(nearest, torch.tensor([[60.0], [-60.0]]))
    torch.testing.assert_close(aside, torch.full((2, 1), 1.01))


def test_steps_towards_a_lamp_subtend_equal_angles_on_either_side_and_tile_the_ray() -> None:
    rays = two_rays()
    edges = edges_towards_lamp(rays, LAMP, RADIUS, 12)
    assert edges.shape == (2, 13)
    assert (edges.diff(dim=1) >= 0.0).all()
    torch.testing.assert_close(edges[:, -1], rays.distance)
    assert torch.equal(edges[:, 0], torch.zeros(2))
    angles = angles_at_lamp(rays, edges, LAMP, RADIUS).diff(dim=1)
    # Almost half a turn takes all steps, with a border next to the lamp.
    assert float((edges[0] - 60.0).abs().min()) < 1e-3
    torch.testing.assert_close(angles[0], torch.full((12,), math.pi / 12.0, dtype=torch.float64), atol=0.01, rtol=0.0)
    assert float(edges[0].diff().max()) > 20.0 * float(edges[0].diff().min())
    # A ray that hardly turns as seen from the lamp has one step.
    assert (edges[1, 1:] == 10.0).all()


def test_a_ray_that_ends_before_the_lamp_or_begins_behind_it_has_its_steps_on_one_side() -> None:
    direction = torch.tensor([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    rays = ViewRays(torch.tensor([[0.0, 0.0, 0.0], [60.5, 0.0, 0.0]]), direction, torch.tensor([59.5, 40.0]))
    angles = angles_at_lamp(rays, edges_towards_lamp(rays, LAMP, RADIUS, 12), LAMP, RADIUS)
    steps = angles.diff(dim=1)
    whole = angles[:, -1] - angles[:, 0]
    for one, angle in zip(steps, whole, strict=True):
        taken = one[one > 1e-9]
        assert len(taken) == math.ceil(12.0 * float(angle) / math.pi)
        torch.testing.assert_close(taken, torch.full_like(taken, float(angle) / len(taken)), atol=1e-4, rtol=0.0)


def test_fewer_than_two_steps_are_refused() -> None:
    with pytest.raises(ParameterError, match="at least two steps"):
        edges_towards_lamp(two_rays(), LAMP, RADIUS, 1)


def test_angles_and_distances_are_inverse_and_the_brightest_place_halves_the_angle() -> None:
    rays = two_rays()
    edges = torch.tensor([[0.0, 40.0, 59.0, 64.0, 100.0], [0.0, 1.0, 1.0, 4.0, 10.0]])
    angles = angles_at_lamp(rays, edges, LAMP, RADIUS)
    torch.testing.assert_close(distances_at_angles(rays, angles, LAMP, RADIUS), edges.double(), atol=1e-4, rtol=0.0)
    middle = distances_at_angles(rays, 0.5 * (angles[:, 1:] + angles[:, :-1]), LAMP, RADIUS)
    found = brightest_places(rays, edges, LAMP, RADIUS)
    torch.testing.assert_close(found.double(), middle, atol=1e-3, rtol=0.0)
    assert not torch.allclose(found, 0.5 * (edges[:, 1:] + edges[:, :-1]), atol=1e-2)


def test_the_mean_inverse_square_is_finite_through_the_lamp_itself() -> None:
    rays = ViewRays(torch.zeros(1, 3), torch.tensor([[1.0, 0.0, 0.0]]), torch.tensor([10.0]))
    edges = torch.tensor([[0.0, 4.0, 6.0, 6.0, 10.0]])
    found = inverse_square_mean(rays, edges, (5.0, 0.0, 0.0), 0.5)
    wanted = torch.tensor(
        [
            2.0 * math.atan(10.0) - 2.0 * math.atan(2.0),
            4.0 * math.atan(2.0),
            0.0,
            2.0 * math.atan(10.0) - 2.0 * math.atan(2.0),
        ]
    )
    torch.testing.assert_close(found * edges.diff(dim=1), wanted[None], rtol=1e-5, atol=1e-6)
    assert float(found[0, 2]) == pytest.approx(1.0 / 1.25)
