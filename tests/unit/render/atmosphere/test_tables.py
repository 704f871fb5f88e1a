"""Sizes, nodes and look-ups of the tables: each node is met where it stands, and nothing crosses the horizon."""

from dataclasses import replace

import pytest
import torch

from render.atmosphere import table_mapping as mapping
from render.atmosphere.air_ray import AirRay
from render.atmosphere.earth import earth
from render.atmosphere.tables import (
    TableSizes,
    irradiance_nodes,
    look_up_irradiance,
    look_up_scattering,
    scattering_nodes,
    transmittance_nodes,
    view_index,
)
from render.errors import ParameterError
from tests.support.atmospheres import KM, SMALL, just_below_horizon, planet, ray, small_states, tensor

PLANET = planet()


def numbered(sizes: TableSizes) -> torch.Tensor:
    """A table of scattered light whose values tell the node: its places on the four axes."""
    grids = torch.meshgrid(*(torch.arange(n, dtype=torch.float64) for n in sizes.scattering), indexing="ij")
    return torch.stack(grids, -1)


def test_nodes_are_looked_up_where_they_stand() -> None:
    table = numbered(SMALL)
    for node in (0, 3, SMALL.radii - 1):
        rays = scattering_nodes(PLANET, SMALL, node).expanded()
        found = look_up_scattering(PLANET, table, rays)
        torch.testing.assert_close(found[..., 0], torch.full_like(found[..., 0], node), atol=1e-6, rtol=0.0)
        torch.testing.assert_close(found[..., 3], table[node, ..., 3], atol=1e-6, rtol=0.0)
        if node:
            torch.testing.assert_close(found[..., 1], table[node, ..., 1], atol=1e-5, rtol=0.0)
        moved = (
            rays.cos_view_sun
            - mapping.cosine_from_unit(torch.linspace(0.0, 1.0, SMALL.view_suns, dtype=torch.float64))[:, None]
        )
        free = moved.abs() < 1e-12
        torch.testing.assert_close(found[..., 2][free], table[node, ..., 2][free], atol=1e-6, rtol=0.0)
        assert 0.1 < float(free.double().mean()) < 0.9


def test_angles_between_ray_and_sun_are_possible_ones() -> None:
    rays = scattering_nodes(PLANET, SMALL, 4).expanded()
    view, sun = torch.acos(rays.cos_view), torch.acos(rays.cos_sun)
    between = torch.acos(rays.cos_view_sun)
    assert bool((between >= (view - sun).abs() - 1e-7).all())
    assert bool((torch.cos(between) >= torch.cos(view + sun) - 1e-9).all())


@pytest.mark.parametrize("altitude", [1.0, 1e3, 100 * KM])
def test_the_horizon_is_the_first_and_the_last_view_and_is_not_crossed(altitude: float) -> None:
    radius = PLANET.bottom_radius + altitude
    table = numbered(SMALL)
    below = ray(PLANET, radius, just_below_horizon(PLANET, radius, 1e-12), 0.5, 0.0)
    above = ray(PLANET, radius, just_below_horizon(PLANET, radius, -1e-12), 0.5, 0.0)
    assert float(look_up_scattering(PLANET, table, below)[1]) < 0.01
    assert float(look_up_scattering(PLANET, table, above)[1]) > SMALL.views - 1.01
    half = SMALL.views // 2
    down, up = (ray(PLANET, radius, view, 0.5, view * 0.5) for view in (-1.0, 1.0))
    assert float(view_index(PLANET, SMALL.views, down)) == pytest.approx(half - 1)
    assert float(view_index(PLANET, SMALL.views, up)) == pytest.approx(half)


def test_the_transmittance_and_the_irradiance_begin_on_the_ground_and_end_at_the_top() -> None:
    radius, cosine = transmittance_nodes(PLANET, SMALL)
    assert cosine.shape == (SMALL.transmittance_radii, SMALL.transmittance_views)
    assert [float(radius[0]), float(radius[-1])] == [PLANET.bottom_radius, PLANET.top_radius]
    torch.testing.assert_close(cosine[:, 0], torch.ones(SMALL.transmittance_radii, dtype=torch.float64))
    assert float(cosine[0, -1]) == pytest.approx(0.0, abs=1e-9)
    radius, cosine = irradiance_nodes(PLANET, SMALL)
    assert [float(radius[0]), float(radius[-1])] == [PLANET.bottom_radius, PLANET.top_radius]
    assert [float(cosine[0]), float(cosine[-1])] == [-1.0, 1.0]


def test_irradiance_is_looked_up_where_it_was_put() -> None:
    """A table linear in both axes; its nodes are its functions' values, and another sun finds another value."""
    radius, cosine = irradiance_nodes(PLANET, SMALL)
    table = torch.stack([radius / PLANET.bottom_radius + cosine, radius * 0 + cosine], -1)
    at, sun = tensor(1234.0 * KM), tensor(0.123)
    found = look_up_irradiance(PLANET, table, at, sun)
    torch.testing.assert_close(found, tensor(1.234 + 0.123, 0.123))
    assert float((look_up_irradiance(PLANET, table, at, tensor(0.5)) - found).abs().min()) > 1e-3


@pytest.mark.parametrize(
    "sizes", [{"radii": 1}, {"views": 3}, {"views": 2}, {"suns": 0}, {"radii": 4096, "views": 4096, "suns": 4096}]
)
def test_impossible_sizes_are_refused(sizes: dict[str, int]) -> None:
    with pytest.raises(ParameterError):
        TableSizes(**sizes)


def test_tables_that_do_not_fit_are_refused() -> None:
    good = small_states()[0].tables(earth())
    assert good.orders == 1
    for change in (
        {"transmittance": good.transmittance[0]},
        {"irradiance": good.irradiance[..., :2]},
        {"scattering": good.scattering[:4]},
    ):
        with pytest.raises(ParameterError):
            replace(good, **change)


def test_rays_need_not_have_the_same_shape() -> None:
    rays = AirRay.towards(PLANET, tensor(1100.0 * KM), tensor(0.1, 0.2)[:, None], tensor(0.3, 0.4, 0.5), tensor(0.0))
    assert look_up_scattering(PLANET, numbered(SMALL), rays).shape == (2, 3, 4)
