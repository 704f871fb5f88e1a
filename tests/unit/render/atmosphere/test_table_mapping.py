"""Mappings: limits on the first and last node, inverse of each other, and the reference's numbers."""

from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from render.atmosphere import table_mapping as mapping
from render.atmosphere.air_ray import AirRay
from render.atmosphere.earth import earth
from render.atmosphere.ray_geometry import horizon_cosine
from render.atmosphere.tables import TableSizes, view_index
from tests.support.atmospheres import KM, SMALL, golden, planet, tensor

PLANET = planet()
UNITS = torch.linspace(0.0, 1.0, 33, dtype=torch.float64)
MIDDLE = tensor(0.6)
RADIUS = mapping.radius_from_unit(PLANET, MIDDLE)

PAIRS: dict[str, tuple[Callable[[Tensor], Tensor], Callable[[Tensor], Tensor]]] = {
    "radius": (lambda r: mapping.unit_from_radius(PLANET, r), lambda x: mapping.radius_from_unit(PLANET, x)),
    "sky view": (
        lambda mu: mapping.unit_from_sky_view(PLANET, RADIUS, mu),
        lambda x: mapping.sky_view_from_unit(PLANET, MIDDLE, x),
    ),
    "ground view": (
        lambda mu: mapping.unit_from_ground_view(PLANET, RADIUS, mu),
        lambda x: mapping.ground_view_from_unit(PLANET, MIDDLE, x),
    ),
    "sun": (lambda mu: mapping.unit_from_sun(earth(), mu), lambda x: mapping.sun_from_unit(earth(), x)),
    "cosine": (mapping.unit_from_cosine, mapping.cosine_from_unit),
    "altitude": (lambda r: mapping.unit_from_altitude(PLANET, r), lambda x: mapping.altitude_from_unit(PLANET, x)),
}
HORIZON = float(horizon_cosine(PLANET, RADIUS))
LIMITS = {
    "radius": (1000.0 * KM, 1500.0 * KM),
    "sky view": (1.0, HORIZON),
    "ground view": (-1.0, HORIZON),
    "sun": (earth().min_cos_sun_zenith, 1.0),
    "cosine": (-1.0, 1.0),
    "altitude": (1000.0 * KM, 1500.0 * KM),
}


@pytest.mark.parametrize("name", PAIRS)
def test_each_pair_is_inverse_both_ways_and_monotonous(name: str) -> None:
    to_unit, from_unit = PAIRS[name]
    values = from_unit(UNITS)
    torch.testing.assert_close(to_unit(values), UNITS, atol=1e-7, rtol=0.0)
    torch.testing.assert_close(from_unit(to_unit(values)), values, atol=1e-9, rtol=1e-12)
    steps = values.diff()
    assert bool((steps > 0.0).all()) or bool((steps < 0.0).all())
    assert float((from_unit(UNITS + 0.01).clamp(max=1e9) - values).abs()[:-1].max()) > 1e-3


@pytest.mark.parametrize("name", PAIRS)
def test_limits_are_the_first_and_last_node(name: str) -> None:
    to_unit, from_unit = PAIRS[name]
    low, high = LIMITS[name]
    torch.testing.assert_close(to_unit(tensor(low, high)), tensor(0.0, 1.0), atol=1e-6, rtol=0.0)
    torch.testing.assert_close(from_unit(tensor(0.0, 1.0)), tensor(low, high), atol=1e-9, rtol=1e-12)


def test_a_sun_lower_than_the_tables_stays_on_the_last_node() -> None:
    below = tensor(earth().min_cos_sun_zenith - 0.1, -0.9, -1.0)
    assert mapping.unit_from_sun(earth(), below).tolist() == [0.0, 0.0, 0.0]
    assert float(mapping.unit_from_sun(earth(), tensor(-0.2))) > 0.0


def test_rays_on_the_ground_and_at_the_top_have_their_limits() -> None:
    ground, top = tensor(0.0), tensor(1.0)
    assert bool((mapping.ground_view_from_unit(PLANET, ground, UNITS) == -1.0).all())
    assert float(mapping.unit_from_ground_view(PLANET, tensor(PLANET.bottom_radius), tensor(-0.3))) == 0.0
    assert float(mapping.sky_view_from_unit(PLANET, top, tensor(0.0))) == 1.0
    assert float(mapping.unit_from_sky_view(PLANET, tensor(PLANET.top_radius), tensor(0.4))) == 0.0


def texture_coordinates(sizes: TableSizes, ray: AirRay) -> np.ndarray:
    """The reference's coordinates `(ray, 4)` of nu, mu_s, mu, r: a node lies in the middle of its texel."""

    def texel(unit: Tensor, count: int) -> Tensor:
        return (unit * (count - 1) + 0.5) / count

    return torch.stack(
        [
            mapping.unit_from_cosine(ray.cos_view_sun),
            texel(mapping.unit_from_sun(earth(), ray.cos_sun), sizes.suns),
            (view_index(earth(), sizes.views, ray) + 0.5) / sizes.views,
            texel(mapping.unit_from_radius(earth(), ray.radius), sizes.radii),
        ],
        -1,
    ).numpy()


@pytest.mark.parametrize(("sizes", "suffix"), [(TableSizes(), ""), (SMALL, "_small")])
def test_places_of_the_reference(sizes: TableSizes, suffix: str) -> None:
    data = golden("mappings")
    names = ("fwd_r_m", "fwd_mu", "fwd_mu_s", "fwd_nu", "fwd_intersects_ground")
    ray = AirRay(*(torch.from_numpy(data[name]) for name in names))
    expected = data[f"fwd_uvwz{suffix}"]
    assert np.abs(texture_coordinates(sizes, ray) - expected).max() < 1e-9
    other = AirRay(*ray.tensors()[:4], ~ray.intersects_ground)
    assert np.abs(texture_coordinates(sizes, other) - expected).max() > 0.1


def test_rays_of_the_reference() -> None:
    data, sizes = golden("mappings"), TableSizes()
    nu, sun, view, radius = (torch.from_numpy(column) for column in data["inv_uvwz"].T)

    def unit(coordinate: Tensor, count: int) -> Tensor:
        return (coordinate - 0.5 / count) / (1.0 - 1.0 / count)

    x_radius, half = unit(radius, sizes.radii), sizes.views // 2
    ground = mapping.ground_view_from_unit(earth(), x_radius, unit(1.0 - 2.0 * view, half))
    sky = mapping.sky_view_from_unit(earth(), x_radius, unit(2.0 * view - 1.0, half))
    assert ((view < 0.5).numpy() == data["inv_intersects_ground"]).all()
    found = {
        "r_m": mapping.radius_from_unit(earth(), x_radius),
        "mu": torch.where(view < 0.5, ground, sky),
        "mu_s": mapping.sun_from_unit(earth(), unit(sun, sizes.suns)),
        "nu": mapping.cosine_from_unit(nu),
    }
    for name, values in found.items():
        np.testing.assert_allclose(values.numpy(), data[f"inv_{name}"], rtol=1e-12, atol=1e-9, err_msg=name)
    assert np.abs(torch.where(view < 0.5, sky, ground).numpy() - data["inv_mu"]).max() > 0.1


def test_rays_of_the_reference_in_the_transmittance() -> None:
    data = golden("mappings")
    view, radius = (torch.from_numpy(column) for column in data["tinv_uv"].T)
    x_radius, x_view = (radius - 0.5 / 64) * 64 / 63, (view - 0.5 / 256) * 256 / 255
    np.testing.assert_allclose(mapping.radius_from_unit(earth(), x_radius).numpy(), data["tinv_r_m"], rtol=1e-14)
    found = mapping.sky_view_from_unit(earth(), x_radius, x_view).numpy()
    np.testing.assert_allclose(found, data["tinv_mu"], atol=1e-10)
    assert np.abs(mapping.sky_view_from_unit(earth(), x_radius, view).numpy() - data["tinv_mu"]).max() > 1e-4
