"""The table of sunlight against the exact integral."""

import torch

from render.atmosphere.earth import earth
from render.atmosphere.ray_geometry import distance_to_top_boundary, horizon_cosine
from render.atmosphere.shells import compute_columns, compute_exact_sun_transmittance, cut_into_shells
from render.atmosphere.sun_columns import build_sun_columns, look_up_sun_columns, look_up_sunlight, sun_column_nodes

SHELLS = cut_into_shells(earth())
TABLE = build_sun_columns(SHELLS, 96, 512)


def points(count: int = 400) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(6)
    number = torch.rand(2, count, generator=generator, dtype=torch.float64)
    radius = SHELLS.atmosphere.bottom_radius + 60_000.0 * number[0] ** 3
    return radius, -0.15 + 1.15 * number[1] ** 2


def test_nodes_hold_exact_columns() -> None:
    radius, cosine = sun_column_nodes(SHELLS.atmosphere, 96, 512)
    chosen = (slice(None, None, 19), slice(None, None, 73))
    r, mu = radius[chosen], cosine[chosen]
    exact = compute_columns(SHELLS, r, mu, distance_to_top_boundary(SHELLS.atmosphere, r, mu))
    torch.testing.assert_close(look_up_sun_columns(TABLE, r, mu), exact, rtol=1e-6, atol=1e-3)


def test_sunlight_is_exact_to_a_few_ten_thousandths() -> None:
    radius, cos_sun = points()
    exact = compute_exact_sun_transmittance(SHELLS, radius, cos_sun)
    found = look_up_sunlight(TABLE, SHELLS.extinction, radius, cos_sun)
    assert float((found - exact).abs().max()) < 6e-4
    assert bool(((exact == 0.0) == (found == 0.0)).all())
    coarse = look_up_sunlight(build_sun_columns(SHELLS, 12, 32), SHELLS.extinction, radius, cos_sun)
    assert float((coarse - exact).abs().max()) > 3e-3


def test_below_the_horizon_columns_are_those_of_the_horizon() -> None:
    radius = torch.tensor([SHELLS.atmosphere.bottom_radius + 5000.0], dtype=torch.float64)
    horizon = horizon_cosine(SHELLS.atmosphere, radius)
    at, below = look_up_sun_columns(TABLE, radius, horizon), look_up_sun_columns(TABLE, radius, horizon - 0.1)
    torch.testing.assert_close(at, below)
    assert bool((look_up_sunlight(TABLE, SHELLS.extinction, radius, horizon - 0.1) == 0.0).all())
