"""Composed stacks against the reference path tracer, between the nodes of the tables.

Six stacks from independent seeds tell how noisy each pixel of their mean is; the reference tells its own variance. Both share the look-up
of densities and the phase function, nothing else. What the stack adds beyond noise is its bias: the marching steps, the lattice of
source points, the strata along camera rays, and the interpolation between nodes.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import pytest
import torch
from scipy import stats
from torch import Tensor

from precompute.error_budget import Effort
from precompute.scattering_orders import build_scattering_stack
from render.camera import PinholeCamera, frame_volume
from render.density_grid import DensityGrid
from render.path_tracer import ReferenceImage, trace_reference
from render.phase_functions import evaluate_phase_function
from render.procedural_cloud import build_cumulus
from render.ray_march import compute_optical_length
from render.scattering_stack import ScatteringStack, ScatteringTables
from tests.support.statistics import FALSE_ALARM
from tests.support.volumes import smooth_box, towards

EFFORT = Effort(orders=4, points=8000, paths=100_000, strata=16)
SEEDS = 6
SAMPLES = 300
ASYMMETRY = torch.linspace(0.0, 0.85, 7)
LARGEST_DEPTHS = torch.logspace(math.log10(0.2), math.log10(40.0), 7)

LARGEST_EXCESS = 1.3
"""Squared differences of all pixels over their summed variances: one without bias, and 0.1 of spread."""


@dataclass(frozen=True)
class Candidate:
    """Parameters that are no nodes; the optical depth is that of the densest view ray."""

    asymmetry: float
    optical_depth: float
    albedo: float


CANDIDATES = (
    Candidate(0.1, 0.6, 0.95),
    Candidate(0.475, 5.0, 0.98),
    Candidate(0.7, 12.0, 0.9),
    Candidate(0.8, 25.0, 1.0),
)


@dataclass(frozen=True)
class Scene:
    """A cloud as it is seen and lit."""

    grid: DensityGrid
    camera: PinholeCamera
    sun: Tensor
    largest_optical_length: float


@lru_cache
def scene(name: str) -> Scene:
    grid, sun = {
        "cumulus": (build_cumulus(32, seed=1), towards(60.0, 30.0)),
        "waves": (smooth_box(16, 16.0), towards(200.0, 20.0)),
    }[name]
    camera = frame_volume(grid, width=48, height=36)
    assert isinstance(camera, PinholeCamera)
    return Scene(grid, camera, sun, float(compute_optical_length(grid, *camera.rays()).max()))


@lru_cache
def stacks(name: str) -> list[ScatteringTables]:
    seen = scene(name)
    extinction = LARGEST_DEPTHS / seen.largest_optical_length
    return [
        build_scattering_stack(seen.grid, seen.camera, seen.sun, ASYMMETRY, extinction, EFFORT, seed)
        for seed in range(SEEDS)
    ]


def composed(name: str, candidate: Candidate, albedo: float) -> Tensor:
    """Scattered light of every stack `(seed, pixel)`."""
    extinction = candidate.optical_depth / scene(name).largest_optical_length
    parameters = [torch.tensor([v]) for v in (candidate.asymmetry, extinction, albedo)]
    layers = [ScatteringStack(tables)(*parameters) for tables in stacks(name)]
    return torch.stack([(layer.single + layer.multiple)[0] for layer in layers]).double()


@lru_cache
def reference(name: str, candidate: Candidate) -> ReferenceImage:
    seen = scene(name)
    return trace_reference(
        seen.grid,
        seen.camera,
        seen.sun,
        extinction=candidate.optical_depth / seen.largest_optical_length,
        asymmetry=candidate.asymmetry,
        albedo=candidate.albedo,
        orders=EFFORT.orders,
        samples=SAMPLES,
    )


def pixel_excess(images: Tensor, truth: Tensor, variance: Tensor) -> float:
    """Squared differences between the mean of the stacks and the reference over what both variances explain."""
    difference = images.mean(0) - truth
    return float(difference.square().sum() / (variance + images.var(0) / len(images)).sum())


def total_t(images: Tensor, truth: Tensor, variance: Tensor) -> float:
    """Difference of the summed light over its standard deviation; that of the stacks is estimated from the seeds."""
    totals = images.sum(1)
    return float((totals.mean() - truth.sum()) / (totals.var() / len(totals) + variance.sum()).sqrt())


@pytest.mark.parametrize("candidate", CANDIDATES)
@pytest.mark.parametrize("name", ["cumulus", "waves"])
def test_the_stack_is_the_reference_within_both_variances(name: str, candidate: Candidate) -> None:
    image, pixel = reference(name, candidate), stacks(name)[0].pixel
    truth, variance = image.radiance[pixel].double(), image.radiance_variance[pixel].double()
    accepted_t = float(stats.t.isf(0.5 * FALSE_ALARM / (2 * len(CANDIDATES)), SEEDS - 1))
    right = composed(name, candidate, candidate.albedo)
    assert pixel_excess(right, truth, variance) < LARGEST_EXCESS
    assert abs(total_t(right, truth, variance)) < accepted_t
    wrong = composed(name, candidate, 0.9 * candidate.albedo)
    assert pixel_excess(wrong, truth, variance) > LARGEST_EXCESS
    assert abs(total_t(wrong, truth, variance)) > accepted_t


@pytest.mark.parametrize("name", ["cumulus", "waves"])
def test_the_reported_error_predicts_the_difference_between_seeds(name: str) -> None:
    def image(tables: ScatteringTables) -> Tensor:
        phase = evaluate_phase_function(tables.cos_sun, tables.asymmetry[:, None])
        return (phase[:, None] * tables.single + tables.multiple.sum(0)).double()

    first, second = stacks(name)[:2]
    difference = (image(first) - image(second)).square().sum(-1) / image(first).square().sum(-1)
    predicted = first.image_error.square() + second.image_error.square()
    ratio = (difference / predicted).sqrt()
    assert float(ratio.min()) > 1.0 / 1.5
    assert float(ratio.max()) < 1.5


@pytest.mark.parametrize("name", ["cumulus", "waves"])
def test_single_scattering_and_transmittance_are_the_reference_s(name: str) -> None:
    """Neither has noise in the stack, so the reference's variance alone must explain the difference of the sums."""
    for candidate in CANDIDATES:
        image, tables = reference(name, candidate), stacks(name)[0]
        extinction = candidate.optical_depth / scene(name).largest_optical_length
        layers = ScatteringStack(tables)(*(torch.tensor([v]) for v in (candidate.asymmetry, extinction, 1.0)))
        for found, truth, variance in (
            (layers.single[0], image.orders[0], image.orders_variance[0]),
            (layers.transmittance[0], image.transmittance, image.transmittance_variance),
        ):
            off = float((found.double() - truth[tables.pixel]).sum())
            noise = float(variance.double().sum().sqrt())
            # One per cent of bias is the price of steps and sections in 32 voxels; four standard deviations the noise.
            allowed = 0.01 * float(truth.sum()) + 4.0 * noise
            assert abs(off) < allowed
            assert abs(off + 0.1 * float(truth.sum())) > allowed
