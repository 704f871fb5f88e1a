"""Orders of the source function against a closed form and an independent Monte Carlo."""

import math
from collections.abc import Iterator

import numpy as np
import pytest
import torch

from precompute.atmosphere.source_function import OrderOfLight, SourceSizes, compute_orders
from render.atmosphere.accurate_sky import integrate_source
from render.atmosphere.earth import earth
from render.atmosphere.parameters import AtmosphereParameters
from render.atmosphere.ray_quadrature import place_nodes
from render.atmosphere.rays import rays_from_vectors
from render.atmosphere.shells import cut_into_shells
from render.atmosphere.source_function import sun_angle_nodes
from render.atmosphere.sun_columns import build_sun_columns
from render.errors import ParameterError
from tests.support.planets import golden, uniform_air

TINY = SourceSizes(5, 9, 7, 5, 4, 6, 4, 4)


def tiny_orders(planet: AtmosphereParameters) -> Iterator[OrderOfLight]:
    shells = cut_into_shells(planet)
    return compute_orders(shells, TINY, build_sun_columns(shells, 8, 32))


def errors_of_orders(sizes: SourceSizes) -> list[torch.Tensor]:
    """Relative errors of orders 2 to 4 at the rays of the independent Monte Carlo, each `(ray, wavelength)`."""
    rows = golden("monte_carlo")
    shells = cut_into_shells(earth())
    vectors = (torch.from_numpy(np.ascontiguousarray(rows[name])) for name in ("camera_m", "view", "sun"))
    rays = rays_from_vectors(shells.atmosphere, *vectors)
    nodes = place_nodes(shells, rays, rays.length(shells.atmosphere), 12)
    truth = torch.from_numpy(rows["mc_mean_by_order"])
    orders = zip((1, 2, 3), compute_orders(shells, sizes, build_sun_columns(shells)), strict=False)
    return [integrate_source(shells, one.source, rays, nodes) / truth[..., order] - 1.0 for order, one in orders]


def test_a_coarse_table_is_within_a_few_percent() -> None:
    for error in errors_of_orders(SourceSizes().scaled(0.5)):
        assert float(error.abs().median()) < 0.03
        assert float(error.abs().quantile(0.95)) < 0.1
        assert float((1.1 * (1.0 + error) - 1.0).abs().median()) > 0.03


@pytest.mark.slow
def test_the_default_table_is_within_the_noise() -> None:
    for error, median in zip(errors_of_orders(SourceSizes()), (0.005, 0.008, 0.012), strict=True):
        assert float(error.abs().median()) < median
        assert float(error.abs().quantile(0.95)) < 3.0 * median


def test_bright_ground_under_thin_air_has_a_closed_form() -> None:
    """Half of what a point sees is ground of radiance albedo/pi E mu_s, and both lobes are symmetric."""
    planet = uniform_air(1e-10, thickness=100.0, ground_albedo=0.8)
    first = next(tiny_orders(planet))
    cos_sun = torch.cos(sun_angle_nodes(TINY.suns))
    exact = 0.5 * 0.8 / math.pi * planet.solar_irradiance[0] * cos_sun[:4]
    for species in (0, 1):
        found = first.source[0, :4, :, :, species].double()
        torch.testing.assert_close(found, exact[:, None, None].expand_as(found), rtol=2e-3, atol=0.0)
        assert not torch.allclose(found, 1.01 * exact[:, None, None].expand_as(found), rtol=2e-3)
    night = first.source[0, -1]
    assert float(night.abs().max()) < 1e-9 * float(first.source.max())
    assert float(first.sky_irradiance.max()) < 1e-4


def test_light_of_an_order_is_the_last_one_scattered_again() -> None:
    """Twice the air's scattering coefficient is twice the light of order 2 and four times that of order 3, if the air is thin."""
    found = []
    for scattering in (1e-9, 2e-9):
        orders = tiny_orders(uniform_air(scattering))
        found.append([float(next(orders).source.sum()) for _ in range(3)])
    ratios = [twice / once for once, twice in zip(*found, strict=True)]
    assert ratios == pytest.approx([2.0, 4.0, 8.0], rel=0.02)


def test_sizes_scale_and_too_few_are_refused() -> None:
    twice = SourceSizes().scaled(2.0)
    assert (twice.altitudes, twice.suns, twice.polar, twice.nodes) == (31, 95, 28, 16)
    assert SourceSizes().scaled(1.0) == SourceSizes()
    assert SourceSizes().scaled(0.01).turns == 13
    with pytest.raises(ParameterError, match="at least 4"):
        SourceSizes(altitudes=3)
    with pytest.raises(ParameterError, match="degree"):
        SourceSizes(turns=10, degree=20)
