"""The accurate mode, with the sizes that it chooses by itself, against two Monte Carlos and the converged integrals."""

import math
from functools import cache

import numpy as np
import pytest
import torch
from torch import Tensor

from precompute.atmosphere.source_budget import build_source_function
from precompute.atmosphere.source_function import compute_orders
from render.atmosphere.accurate_sky import compute_sky_light, integrate_single_scattering, integrate_source
from render.atmosphere.earth import earth
from render.atmosphere.path_tracer import trace_atmosphere
from render.atmosphere.ray_quadrature import place_nodes
from render.atmosphere.rays import rays_from_vectors
from render.atmosphere.source_function import SourceFunction
from tests.support.planets import golden

pytestmark = pytest.mark.slow

Vectors = tuple[Tensor, Tensor, Tensor]


@cache
def built() -> tuple[SourceFunction, tuple[Tensor, ...]]:
    """The source function of four orders, and the source of each order from the second on."""
    source, report = build_source_function(earth(), tolerance=0.01, orders=4)
    assert report.met
    orders = compute_orders(source.shells, report.sizes, source.sun_columns)
    return source, tuple(next(orders).source for _ in range(3))


def light_by_order(camera: Tensor, view: Tensor, sun: Tensor) -> Tensor:
    """Radiance of the rays `(ray, wavelength, order)`."""
    source, orders = built()
    rays = rays_from_vectors(source.atmosphere, camera, view, sun)
    nodes = place_nodes(source.shells, rays, rays.length(source.atmosphere), source.nodes)
    light = [integrate_single_scattering(source.shells, source.sun_columns, rays, nodes)]
    light += [integrate_source(source.shells, order, rays, nodes) for order in orders]
    torch.testing.assert_close(sum(light), compute_sky_light(source, camera, view, sun).radiance, rtol=1e-4, atol=0.0)
    return torch.stack(light, -1)


def further_rays(count: int = 40) -> Vectors:
    """Cameras from 1 m to 9 km, the sun up to 88 degrees from the zenith, a quarter of the views below the horizon."""
    uniform = torch.rand(4, count, generator=torch.Generator().manual_seed(20), dtype=torch.float64)
    number = torch.arange(count)
    altitude = torch.tensor([1.0, 200.0, 1000.0, 3000.0, 9000.0], dtype=torch.float64)[number % 5]
    zenith, turn = math.radians(88.0) * uniform[0].sqrt(), 2.0 * math.pi * uniform[2]
    cosine = torch.where(number % 4 == 3, -0.05 - 0.95 * uniform[1], uniform[1] ** 1.5)
    sine, zero = (1.0 - cosine * cosine).sqrt(), torch.zeros_like(zenith)
    sun = torch.stack([torch.sin(zenith), zero, torch.cos(zenith)], -1)
    view = torch.stack([sine * torch.cos(turn), sine * torch.sin(turn), cosine], -1)
    return torch.stack([zero, zero, earth().bottom_radius + altitude], -1), view, sun


def tell(name: str, error: np.ndarray) -> None:
    """What `pytest -s` shows: median and 95th percentile of relative errors."""
    print(f"{name}: median {np.median(np.abs(error)):.3%}, 95th percentile {np.quantile(np.abs(error), 0.95):.3%}")


def test_orders_of_an_independent_monte_carlo() -> None:
    rows = golden("monte_carlo")
    camera, view, sun = (torch.from_numpy(rows[name]) for name in ("camera_m", "view", "sun"))
    light, truth = light_by_order(camera, view, sun).numpy(), rows["mc_mean_by_order"]
    for order in (1, 2, 3):
        error = np.abs(light[..., order] / truth[..., order] - 1.0)
        tell(f"order {order + 1}, independent Monte Carlo", error)
        assert np.median(error) < 0.01
        assert np.quantile(error, 0.95) < 0.03
    whole = np.abs(light.sum(-1) / truth.sum(-1) - 1.0)
    tell("sum, independent Monte Carlo", whole)
    assert np.median(whole) < 0.002
    theirs = np.abs(rows["reference_by_order"][..., 1] / truth[..., 1] - 1.0)
    assert np.median(theirs) > 0.02


def test_orders_of_our_monte_carlo_at_further_rays() -> None:
    vectors = further_rays()
    light = light_by_order(*vectors)
    found = trace_atmosphere(earth(), *vectors, orders=4, paths=64_000, seed=77)
    for order in (1, 2, 3):
        truth = found.orders[..., order]
        error = (light[..., order] / truth - 1.0).numpy()
        tell(f"order {order + 1}, our Monte Carlo", error)
        assert np.median(np.abs(error)) < 0.02
        assert np.quantile(np.abs(error), 0.95) < 0.05
        noise = (found.orders_error[..., order] / truth).square().mean()
        assert math.sqrt(max(float((error**2).mean() - noise), 0.0)) < 0.02
    whole = (light.sum(-1) / found.radiance - 1.0).abs()
    tell("sum, our Monte Carlo", whole.numpy())
    assert float(whole.median()) < 0.015
