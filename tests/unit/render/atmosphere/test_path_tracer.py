"""The Monte Carlo truth against exact single scattering, a closed form, an independent Monte Carlo, and itself."""

import math

import numpy as np
import pytest
import torch

from render.atmosphere import path_tracer
from render.atmosphere.earth import earth
from render.atmosphere.parameters import AtmosphereParameters
from render.atmosphere.path_tracer import AtmosphereReference, trace_atmosphere
from render.atmosphere.rays import rays_from_vectors
from render.atmosphere.shells import cut_into_shells
from render.atmosphere.single_scattering import compute_single_radiance
from render.errors import ParameterError
from tests.support.planets import golden, uniform_air
from tests.support.statistics import passes_z_test

Scene = tuple[torch.Tensor, torch.Tensor, torch.Tensor]


def scene(planet: AtmosphereParameters, altitude: float, count: int = 8, sun_zenith_deg: float = 60.0) -> Scene:
    """Rays in many directions from one place."""
    generator = torch.Generator().manual_seed(11)
    direction = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator, dtype=torch.float64), dim=-1)
    position = torch.tensor([0.0, 0.0, planet.bottom_radius + altitude], dtype=torch.float64).expand(count, 3)
    angle = math.radians(sun_zenith_deg)
    return position, direction, torch.tensor([math.sin(angle), 0.0, math.cos(angle)], dtype=torch.float64)


def golden_agreement(chosen: np.ndarray | slice, paths: int, factor: float = 1.0) -> bool:
    rows = golden("monte_carlo")
    vectors = [torch.from_numpy(np.ascontiguousarray(rows[name][chosen])) for name in ("camera_m", "view", "sun")]
    found = trace_atmosphere(earth(), *vectors, orders=4, paths=paths)
    mean, error = (torch.from_numpy(rows[f"mc_{name}_by_order"][chosen]) for name in ("mean", "stderr"))
    return passes_z_test(found.orders - factor * mean, found.orders_error**2 + error**2)


@pytest.mark.parametrize(("altitude", "sun_zenith_deg"), [(1000.0, 60.0), (9000.0, 88.0), (0.0, 20.0)])
def test_the_first_order_is_the_exact_integral(altitude: float, sun_zenith_deg: float) -> None:
    planet = earth()
    vectors = scene(planet, altitude, 12, sun_zenith_deg)
    exact = compute_single_radiance(cut_into_shells(planet), rays_from_vectors(planet, *vectors))
    found = trace_atmosphere(planet, *vectors, orders=1, paths=800)
    for factor, right in ((1.0, True), (1.1, False)):
        difference = found.orders[..., 0] - factor * exact
        assert passes_z_test(difference, found.orders_error[..., 0] ** 2) is right
    torch.testing.assert_close(found.radiance, found.orders[..., 0])


def test_four_orders_are_those_of_an_independent_monte_carlo() -> None:
    chosen = np.array([1, 8, 20, 32])
    assert golden_agreement(chosen, 2500)
    assert not golden_agreement(chosen, 2500, factor=1.2)


@pytest.mark.slow
def test_all_rays_are_those_of_an_independent_monte_carlo() -> None:
    assert golden_agreement(slice(None), 15_000)
    assert not golden_agreement(slice(None), 15_000, factor=1.06)


def test_bright_ground_under_thin_air_has_a_closed_form() -> None:
    """Order 2 from the zenith: half of the sphere is ground of radiance albedo/pi E mu_s, and the air is too thin for more."""
    scattering, thickness = 1e-8, 100.0
    planet = uniform_air(scattering, thickness=thickness, ground_albedo=0.8)
    position, _, sun = scene(planet, 0.0, 1)
    up = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)
    found = trace_atmosphere(planet, position, up, sun, orders=2, paths=20_000)
    exact = 0.5 * scattering * thickness * 0.8 / math.pi * planet.solar_irradiance[0] * float(sun[2])
    for factor, right in ((1.0, True), (1.1, False)):
        assert passes_z_test(found.orders[0, :, 1] - factor * exact, found.orders_error[0, :, 1] ** 2) is right
    black = trace_atmosphere(uniform_air(scattering, thickness=thickness), position, up, sun, orders=2, paths=2000)
    assert float(black.orders[0, 0, 1]) < 1e-3 * exact
    torch.testing.assert_close(black.orders[0, :, 0], found.orders[0, :, 0], rtol=0.2, atol=0.0)


def test_air_that_only_absorbs_is_dark_and_no_air_too() -> None:
    dark = uniform_air(0.0, extinction=1e-5, ground_albedo=1.0)
    vectors = scene(dark, 1000.0)
    assert float(trace_atmosphere(dark, *vectors, orders=3, paths=50).radiance.abs().max()) == 0.0
    nothing = uniform_air(0.0, ground_albedo=1.0)
    assert float(trace_atmosphere(nothing, *vectors, orders=3, paths=50).radiance.abs().max()) == 0.0


def test_the_result_depends_on_the_seed_but_not_on_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    planet = earth()
    vectors = scene(planet, 500.0, 3)

    def trace(seed: int) -> AtmosphereReference:
        return trace_atmosphere(planet, *vectors, orders=3, paths=60, seed=seed)

    whole = trace(5)
    assert not torch.allclose(trace(6).orders, whole.orders, rtol=1e-3)
    monkeypatch.setattr(path_tracer, "LANES", 17)
    torch.testing.assert_close(trace(5).orders, whole.orders, rtol=1e-12, atol=0.0)


def test_thick_aerosol_low_sun_and_both_boundaries_stay_finite() -> None:
    planet = earth().with_aerosol(100.0)
    for altitude in (0.0, planet.thickness):
        for sun_zenith_deg in (0.0, 90.0, 110.0):
            vectors = scene(planet, altitude, 4, sun_zenith_deg)
            found = trace_atmosphere(planet, *vectors, orders=6, paths=40)
            assert bool(torch.isfinite(found.orders).all())
            assert bool((found.orders >= 0.0).all())
            assert bool(torch.isfinite(found.radiance_error).all())


def test_no_paths_and_no_order_are_refused() -> None:
    planet = earth()
    vectors = scene(planet, 0.0, 1)
    for orders, paths in ((0, 10), (1, 1)):
        with pytest.raises(ParameterError, match="two paths"):
            trace_atmosphere(planet, *vectors, orders=orders, paths=paths)
