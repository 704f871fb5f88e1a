"""The whole build: every stage of the reference at its default size, float32, scale, and the number of wavelengths."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from precompute.atmosphere_tables import (
    OrderState,
    TablePlan,
    build_atmosphere_tables,
    build_first_order,
    build_next_order,
)
from render.atmosphere.earth import earth
from render.atmosphere.parameters import AtmosphereParameters, DensityLayer, DensityProfile
from render.atmosphere.sky import look_up_radiance_to_point, look_up_sky_radiance, look_up_surface_irradiance
from render.atmosphere.tables import TableSizes
from render.errors import ParameterError
from tests.support.atmospheres import PARITY, SMALL, golden, peak_error, small_states

TINY = TableSizes(8, 32, 4, 8, 4, 8, 3, 6)


def test_the_sum_of_all_orders_of_the_reference() -> None:
    data, states = golden("textures_small"), small_states()
    expected = data["scattering_sum_4"]
    assert peak_error(states[3].scattering.reshape(expected.shape), expected) < PARITY
    assert peak_error(states[2].scattering.reshape(expected.shape), expected) > 1e-4


def test_float32_tables_differ_by_less_than_stated() -> None:
    for exact, rounded in zip(small_states(), small_states("float32"), strict=True):
        for name in ("transmittance", "irradiance", "scattering", "single_mie"):
            table, other = getattr(exact, name), getattr(rounded, name)
            assert other.dtype == torch.float32
            error = float((table - other).abs().max()) / float(table.abs().max().clamp(min=1e-300))
            assert error < 1e-6, (exact.order, name)
    assert float((small_states()[3].scattering - small_states("float32")[3].scattering).abs().max()) > 0.0


def scaled(profile: DensityProfile, factor: float) -> DensityProfile:
    layers = (
        DensityLayer(factor * y.width, y.exp_term, y.exp_scale / factor, y.linear_term / factor, y.constant_term)
        for y in profile.layers
    )
    return DensityProfile(tuple(layers))


def larger_planet(atmosphere: AtmosphereParameters, factor: float) -> AtmosphereParameters:
    """All lengths times a factor, all coefficients divided by it."""
    coefficients = ("rayleigh_scattering", "mie_scattering", "mie_extinction", "absorption_extinction")
    profiles = ("rayleigh_density", "mie_density", "absorption_density")
    return replace(
        atmosphere,
        bottom_radius=factor * atmosphere.bottom_radius,
        top_radius=factor * atmosphere.top_radius,
        **{name: tuple(value / factor for value in getattr(atmosphere, name)) for name in coefficients},
        **{name: scaled(getattr(atmosphere, name), factor) for name in profiles},
    )


def test_a_larger_planet_with_thinner_air_looks_the_same() -> None:
    plan = TablePlan(sizes=TINY, orders=3)
    here, there = (build_atmosphere_tables(larger_planet(earth(), f), plan) for f in (1.0, 8.0))
    torch.testing.assert_close(here.scattering, there.scattering, rtol=1e-6, atol=1e-7)
    torch.testing.assert_close(here.irradiance, there.irradiance, rtol=1e-6, atol=1e-9)
    denser = build_atmosphere_tables(earth().with_aerosol(1.5), plan)
    assert not torch.allclose(here.scattering, denser.scattering, rtol=1e-3)


def test_a_wavelength_does_not_know_the_others() -> None:
    plan = TablePlan(sizes=TINY, orders=3)
    together = build_atmosphere_tables(earth((680e-9, 550e-9, 440e-9, 400e-9)), plan)
    alone = build_atmosphere_tables(earth((550e-9,)), plan)
    torch.testing.assert_close(together.scattering[..., 1:2], alone.scattering, rtol=1e-12, atol=1e-15)
    assert not torch.allclose(together.scattering[..., :1], alone.scattering, rtol=1e-2)


def test_orders_grow_smaller_and_only_add_light() -> None:
    states = small_states()
    means = [float(state.light[0].mean()) for state in states[1:]]
    assert means[0] > means[1] > means[2] > 0.0
    for state in states:
        assert float(state.scattering.min()) >= 0.0
        assert float(state.irradiance.min()) >= 0.0


def test_progress_is_told_and_one_order_is_single_scattering() -> None:
    told: list[tuple[str, float]] = []
    tables = build_atmosphere_tables(earth(), TablePlan(sizes=TINY, orders=2), lambda *told_now: told.append(told_now))
    assert [name for name, share in told if share == 1.0] == ["transmittance", "order 1", "order 2"]
    assert [share for name, share in told if name == "order 2"] == sorted(
        share for name, share in told if name == "order 2"
    )
    assert tables.orders == 2
    single = build_atmosphere_tables(earth(), TablePlan(sizes=TINY, orders=1))
    assert float(single.irradiance.abs().max()) == 0.0


def test_threads_do_not_change_the_numbers() -> None:
    plan = TablePlan(sizes=TINY, orders=2)
    one = build_atmosphere_tables(earth(), plan)
    torch.set_num_threads(2)
    try:
        two = build_atmosphere_tables(earth(), plan)
    finally:
        torch.set_num_threads(1)
    assert torch.equal(one.scattering, two.scattering)


def test_impossible_plans_are_refused() -> None:
    with pytest.raises(ParameterError, match="at least once"):
        TablePlan(orders=0)
    with pytest.raises(ParameterError, match="float16"):
        TablePlan(precision="float16")
    assert TablePlan(sizes=SMALL) != TablePlan()


@pytest.mark.slow
def test_the_default_tables_and_look_ups_of_the_reference() -> None:
    """Every stage at the default size, and the look-ups after one to four orders."""
    data, plan = golden("textures_full_samples"), TablePlan()
    texels = tuple(torch.from_numpy(data["texel_kji"].astype(np.int64)).unbind(1))

    def check(name: str, table: torch.Tensor) -> None:
        values = table if table.dim() == 3 else table.flatten(2, 3)[texels]
        assert peak_error(values, data[name]) < PARITY, name

    state = build_first_order(earth(), plan)
    check("transmittance", state.transmittance)
    check("delta_irradiance_0", state.ground_irradiance)
    for name, table in zip(("delta_rayleigh", "delta_mie"), state.light, strict=True):
        check(name, table)
    check_look_ups(state)
    while state.order < plan.orders:
        state = build_next_order(earth(), plan, state)
        n = state.order
        assert state.density is not None
        check(f"scattering_density_{n}", state.density)
        check(f"delta_multiple_{n}", state.light[0])
        check(f"delta_irradiance_{n - 1}", state.ground_irradiance)
        check(f"scattering_sum_{n}", state.scattering)
        check(f"irradiance_sum_init{n}", state.irradiance)
        check_look_ups(state)


RADIANCES = {1: "L_order1", 2: "L_orders1_2", 3: "L_orders1_3", 4: "L_orders1_4"}


def check_look_ups(state: OrderState) -> None:
    """Sky radiance and irradiance after any order, aerial perspective and cameras in space after the first and the last."""
    tables, n = state.tables(earth()), state.order

    def arguments(data: dict[str, np.ndarray], *names: str) -> list[torch.Tensor]:
        return [torch.from_numpy(data[name]) for name in names]

    data = golden("sky_radiance")
    found = look_up_sky_radiance(tables, *arguments(data, "camera_m", "view", "sun"))
    assert peak_error(found.radiance, data[RADIANCES[n]]) < PARITY
    assert peak_error(found.transmittance, data["transmittance"]) < PARITY
    data = golden("irradiance")
    lit = look_up_surface_irradiance(tables, *arguments(data, "point_m", "normal", "sun"))
    assert peak_error(lit.sun, data["sun_irradiance"]) < PARITY
    if n > 1:
        assert peak_error(lit.sky, data[f"sky_init{n}"]) < PARITY
    if n in (1, 4):
        data = golden("sky_radiance_extra")
        found = look_up_sky_radiance(tables, *arguments(data, "camera_m", "view", "sun", "shadow_length_m"))
        assert peak_error(found.radiance, data[RADIANCES[n]]) < PARITY
        data = golden("aerial_perspective")
        found = look_up_radiance_to_point(tables, *arguments(data, "camera_m", "point_m", "sun", "shadow_length_m"))
        name = "inscatter_order1" if n == 1 else "inscatter_orders1_4"
        # The reference's few negative differences are held at zero here.
        assert peak_error(found.radiance, data[name].clip(min=0.0)) < PARITY
        assert peak_error(found.transmittance, data["transmittance"]) < PARITY
