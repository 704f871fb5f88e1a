"""Nodes along rays against exact columns."""

import pytest
import torch

from render.atmosphere.air_ray import AirRay
from render.atmosphere.earth import earth
from render.atmosphere.ray_quadrature import place_nodes
from render.atmosphere.rays import chosen_rays
from render.atmosphere.shells import Shells, compute_columns, cut_into_shells

SHELLS = cut_into_shells(earth())


def some_rays(count: int = 200) -> AirRay:
    generator = torch.Generator().manual_seed(5)
    number = torch.rand(2, count, generator=generator, dtype=torch.float64)
    radius = SHELLS.atmosphere.bottom_radius + 60_000.0 * number[0] ** 3
    cosine = 2.0 * number[1] - 1.0
    return AirRay.towards(SHELLS.atmosphere, radius, cosine, cosine, cosine)


def worst_column(shells: Shells, rays: AirRay, length: torch.Tensor, nodes: int) -> float:
    """Largest error of an optical depth by the nodes' weights, relative to 1 + itself."""
    placed = place_nodes(shells, rays, length, nodes)
    columns = (placed.weight[..., None] * placed.density).sum(1) @ shells.extinction
    exact = compute_columns(shells, rays.radius, rays.cos_view, length) @ shells.extinction
    torch.testing.assert_close(placed.transmittance_to_end, torch.exp(-columns))
    return float(((columns - exact).abs() / (1.0 + exact)).max())


@pytest.mark.parametrize("share", [1.0, 0.4])
def test_weights_integrate_the_air(share: float) -> None:
    rays = some_rays()
    length = share * rays.length(SHELLS.atmosphere)
    assert worst_column(SHELLS, rays, length, 16) < 2e-3
    assert worst_column(SHELLS, rays, length, 8) < 2e-2
    assert worst_column(SHELLS, rays, length, 2) > 3e-2


def test_transmittances_at_the_nodes_are_exact() -> None:
    rays = some_rays()
    placed = place_nodes(SHELLS, rays, rays.length(SHELLS.atmosphere), 16)
    here = rays.unsqueeze()
    exact = torch.exp(-compute_columns(SHELLS, here.radius, here.cos_view, placed.distance) @ SHELLS.extinction)
    error = (placed.transmittance - exact).abs()
    assert float(error.max()) < 2e-3  # a ray along the kink of the ozone
    assert float(error.median()) < 1e-6
    shifted = torch.exp(-compute_columns(SHELLS, here.radius, here.cos_view, 0.9 * placed.distance) @ SHELLS.extinction)
    assert float((placed.transmittance - shifted).abs().max()) > 1e-2


def test_nodes_come_in_order_and_cover_the_ray() -> None:
    rays = some_rays()
    length = rays.length(SHELLS.atmosphere)
    placed = place_nodes(SHELLS, rays, length, 8)
    assert bool((placed.distance[:, 1:] >= placed.distance[:, :-1]).all())
    assert bool((placed.distance <= length[:, None] * (1.0 + 1e-12)).all())
    torch.testing.assert_close(placed.weight.sum(1), length)


def test_a_ray_of_no_length_is_clear() -> None:
    rays = chosen_rays(some_rays(), torch.arange(3))
    placed = place_nodes(SHELLS, rays, torch.zeros(3, dtype=torch.float64), 8)
    assert bool((placed.transmittance_to_end == 1.0).all())
    assert float(placed.scattering_weights(SHELLS).abs().max()) == 0.0
