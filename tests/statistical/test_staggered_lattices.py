"""Halves of carried light on staggered lattices."""

import torch

from precompute.carried_orders import STAGGER, CarryingEffort, carry_orders, resolving_lattices
from precompute.light_lattice import LightLattice, light_lattice_over
from precompute.order_plan import plan_orders
from tests.support.carried import cloud_view
from tests.support.volumes import noise_box

EFFORT = CarryingEffort(3, 2, 3000, 1.0 / 32.0, 3.5)


def test_points_of_one_half_lie_in_the_middle_of_the_other_ones_cells() -> None:
    lattices = resolving_lattices(noise_box(12), 1.0, EFFORT)
    assert lattices is not None
    first, second = (one.lattice for one in lattices)
    torch.testing.assert_close(second.corner - first.corner, 0.5 * first.spacing)
    torch.testing.assert_close(first.spacing, second.spacing)


def test_halves_on_staggered_lattices_miss_less_of_a_cloud_and_tell_more_of_it() -> None:
    view = cloud_view()
    extinction = torch.tensor([20.0 / view.largest_optical_length])
    inside = view.grid.lower + torch.rand(4000, 3, generator=torch.Generator().manual_seed(1)) * (
        view.grid.upper - view.grid.lower
    )
    inside = inside[view.grid.look_up_density(inside) > 0]

    def carry_on(lattices: tuple[LightLattice, LightLattice]) -> torch.Tensor:
        carried = [
            carry_orders(view, lattices, torch.zeros(1), extinction, plan_orders(18), EFFORT, 0.5, seed).at(0, inside)
            for seed in range(4)
        ]
        return torch.stack(carried).mean(0).sum((2, 3))

    def staggered(points: int, shifts: tuple[float, float]) -> tuple[float, float]:
        """Relative error of the mean of the halves, and what their difference says of it."""
        first, second = (light_lattice_over(view.grid, 1.0, points, shift) for shift in shifts)
        halves = carry_on((first, second))
        scale = exact.square().mean().sqrt()
        error = (halves.mean(1) - exact).square().mean().sqrt() / scale
        return float(error), float((halves[:, 0] - halves[:, 1]).square().mean().sqrt() / 2.0 / scale)

    fine = light_lattice_over(view.grid, 1.0, 10_000)
    exact = carry_on((fine, fine)).mean(1)
    apart, together = staggered(300, STAGGER), staggered(300, (0.0, 0.0))
    assert apart[0] < 0.9 * together[0]
    assert apart[1] > 2.0 * together[1]
