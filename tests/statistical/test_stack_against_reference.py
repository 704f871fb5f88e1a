"""Composed stacks against the reference path tracer, between the nodes of the tables.

Six stacks from independent seeds tell how noisy each pixel of their mean is; the reference tells its own variance. Both share the look-up
of densities and the phase function, nothing else. What the stack adds beyond noise is its bias: the marching steps, the lattice of
source points, the strata along camera rays, and the interpolation between nodes. Smoothing trades noise for bias and is judged by itself:
stacks without it have the reference's mean, those with it the error that they report.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import pytest
import torch
from scipy import stats
from torch import Tensor

from precompute.error_budget import Effort
from precompute.order_plan import plan_orders
from precompute.scattering_orders import build_scattering_stack
from render.camera import PinholeCamera, frame_volume
from render.density_grid import DensityGrid
from render.depth_nodes import place_depths
from render.path_tracer import ReferenceImage, trace_reference
from render.phase_functions import evaluate_phase_function
from render.procedural_cloud import build_cumulus
from render.ray_march import compute_optical_length
from render.scattering_stack import ScatteringStack, ScatteringTables
from tests.support.statistics import FALSE_ALARM
from tests.support.volumes import smooth_box, towards

EFFORT = Effort(orders=4, points=8000, paths=100_000, strata=16)
SEEDS = 6
SAMPLES = 3000
ASYMMETRY = torch.linspace(0.0, 0.85, 7)
LARGEST_DEPTHS = place_depths(0.2, 40.0, 7).float()


@dataclass(frozen=True)
class Candidate:
    """Parameters that are no nodes; the optical depth is that of the densest view ray.

    Args:
        accepted: relative RMS error of the mean of the stacks, without noise. It is that of 8000 source points, 16 strata, and
            interpolation between few nodes in a volume of few voxels: no more noise, but more points and nodes make it smaller.
    """

    asymmetry: float
    optical_depth: float
    albedo: float
    accepted: float


CANDIDATES = (
    Candidate(0.1, 0.6, 0.95, 0.015),
    Candidate(0.475, 5.0, 0.98, 0.03),
    Candidate(0.7, 12.0, 0.9, 0.05),
    Candidate(0.8, 25.0, 1.0, 0.13),
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
def stacks(name: str, smooth: bool = False) -> list[ScatteringTables]:
    seen = scene(name)
    extinction = LARGEST_DEPTHS / seen.largest_optical_length
    with pytest.MonkeyPatch.context() as patch:
        if not smooth:
            patch.setattr("precompute.smoothing.Neighbourhood.levels", lambda self, source, expected: [source])
        return [
            build_scattering_stack(seen.grid, seen.camera, seen.sun, ASYMMETRY, extinction, EFFORT, seed)
            for seed in range(SEEDS)
        ]


def composed(name: str, candidate: Candidate, albedo: float, smooth: bool = False) -> Tensor:
    """Scattered light of every stack `(seed, pixel)`."""
    extinction = candidate.optical_depth / scene(name).largest_optical_length
    parameters = [torch.tensor([v]) for v in (candidate.asymmetry, extinction, albedo)]
    layers = [ScatteringStack(tables)(*parameters) for tables in stacks(name, smooth)]
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


def error_beyond_noise(images: Tensor, truth: Tensor, variance: Tensor) -> float:
    """Relative RMS difference of the mean of the stacks from the reference, both variances subtracted in quadrature."""
    square = (images.mean(0) - truth).square() - images.var(0) / len(images) - variance
    return float((square.sum().clamp(min=0.0) / truth.square().sum()).sqrt())


@pytest.mark.parametrize("candidate", CANDIDATES)
@pytest.mark.parametrize("name", ["cumulus", "waves"])
def test_the_stack_is_the_reference_but_for_its_lattice_and_nodes(name: str, candidate: Candidate) -> None:
    image, pixel = reference(name, candidate), stacks(name)[0].pixel
    truth, variance = image.radiance[pixel].double(), image.radiance_variance[pixel].double()
    noise = float((variance.sum() / truth.square().sum()).sqrt())
    assert noise < 0.15
    right = composed(name, candidate, candidate.albedo)
    assert error_beyond_noise(right, truth, variance) < candidate.accepted
    assert abs(float(right.mean(0).sum() / truth.sum()) - 1.0) < 0.5 * candidate.accepted
    wrong = composed(name, candidate, 0.8 * candidate.albedo)
    assert error_beyond_noise(wrong, truth, variance) > candidate.accepted
    assert abs(float(wrong.mean(0).sum() / truth.sum()) - 1.0) > 0.5 * candidate.accepted


@pytest.mark.parametrize("name", ["cumulus", "waves"])
def test_the_reported_error_predicts_the_difference_between_seeds(name: str) -> None:
    def image(tables: ScatteringTables) -> Tensor:
        phase = evaluate_phase_function(tables.cos_sun, tables.asymmetry[:, None])
        return (phase[:, None] * tables.single + tables.multiple.sum(0)).double()

    first, second = stacks(name)[:2]
    assert_predicted(image(first), image(second), first, second, 1.0 / 1.5)
    # Smoothed, the bias that both seeds share is part of the prediction and not of the difference.
    first, second = stacks(name, True)[:2]
    assert_predicted(image(first), image(second), first, second, 0.0)


def assert_predicted(
    one: Tensor, other: Tensor, first: ScatteringTables, second: ScatteringTables, least: float
) -> None:
    difference = (one - other).square().sum(-1) / one.square().sum(-1)
    predicted = first.image_error.square() + second.image_error.square()
    ratio = (difference / predicted).sqrt()
    assert float(ratio.min()) > least
    assert float(ratio.quantile(0.9)) < 1.5
    assert float(ratio.max()) < 2.0


def reported_error(name: str, candidate: Candidate) -> float:
    """Root of the mean square over the seeds of the error stated at the four nodes around, interpolated to the candidate."""
    rows, depths = ASYMMETRY, LARGEST_DEPTHS.log()
    row, column = (
        int(torch.searchsorted(rows, candidate.asymmetry)),
        int(torch.searchsorted(LARGEST_DEPTHS, candidate.optical_depth)),
    )
    across = float((candidate.asymmetry - rows[row - 1]) / (rows[row] - rows[row - 1]))
    along = float((math.log(candidate.optical_depth) - depths[column - 1]) / (depths[column] - depths[column - 1]))
    squares = torch.stack([t.image_error for t in stacks(name, True)]).square().mean(0)
    low, high = torch.lerp(squares[row - 1, column - 1 : column + 1], squares[row, column - 1 : column + 1], across)
    return math.sqrt(low + along * (high - low))


@pytest.mark.parametrize("candidate", CANDIDATES)
@pytest.mark.parametrize("name", ["cumulus", "waves"])
def test_smoothing_errs_as_much_as_it_reports(name: str, candidate: Candidate) -> None:
    smooth, plain = (composed(name, candidate, candidate.albedo, which) for which in (True, False))
    power = plain.mean(0).square().sum()
    noise = smooth.var(0).sum()
    bias = (smooth.mean(0) - plain.mean(0)).square().sum() - (noise + plain.var(0).sum()) / SEEDS
    found = float(((noise + bias.clamp(min=0.0)) / power).sqrt())
    assert stacks(name, True)[0].image_error.shape == (len(ASYMMETRY), len(LARGEST_DEPTHS))
    reported = reported_error(name, candidate)
    assert 0.4 < found / reported < 1.6
    assert found < float((plain.var(0).sum() / power).sqrt()) * 1.1


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


HIGH_ORDERS = 12
HIGH_SEEDS = 12


@lru_cache
def high_orders(asymmetry: float) -> tuple[Tensor, Tensor]:
    """Images of each knot, summed over the pixels `(seed, knot)`, and energy of the orders from two up by the reference."""
    seen = scene("waves")
    extinction = 15.0 / seen.largest_optical_length
    nodes = torch.tensor([asymmetry]), torch.tensor([extinction])
    effort = Effort(orders=HIGH_ORDERS, points=4000, paths=60_000, strata=16)
    tables = [build_scattering_stack(seen.grid, seen.camera, seen.sun, *nodes, effort, s) for s in range(HIGH_SEEDS)]
    image = trace_reference(
        seen.grid,
        seen.camera,
        seen.sun,
        extinction=extinction,
        asymmetry=asymmetry,
        albedo=1.0,
        orders=HIGH_ORDERS,
        samples=150,
    )
    truth = torch.stack([image.orders.double().sum(1), image.orders_variance.double().sum(1)])[:, 1:]
    return torch.stack([table.multiple[:, 0, 0].double().sum(1) for table in tables]), truth


@pytest.mark.parametrize("asymmetry", [0.2, 0.8])
def test_orders_above_four_have_the_energy_of_the_reference(asymmetry: float) -> None:
    """The sharing conserves each order's energy, so every knot's image has that of its share of the reference's orders."""
    found, (energy, variance) = high_orders(asymmetry)
    shares = plan_orders(HIGH_ORDERS).shares
    assert found.shape[1] == shares.shape[1] == 6
    # Orders of one path of the reference are correlated: at worst their deviations add up.
    deviation = (shares * variance.sqrt()[:, None]).sum(0)

    def scores(truth: Tensor) -> Tensor:
        off = found.mean(0) - truth @ shares
        # One per cent is the price of steps, lattice and strata in 16 voxels.
        off = off.sign() * (off.abs() - 0.01 * found.mean(0)).clamp(min=0.0)
        return (off / (found.var(0) / HIGH_SEEDS + deviation.square()).sqrt()).abs()

    accepted = float(stats.t.isf(0.5 * FALSE_ALARM / (2 * 6), HIGH_SEEDS - 1))
    assert float(scores(energy).max()) < accepted
    assert float(scores(1.3 * energy).median()) > accepted
    total = found[:, 2:].sum(1)
    off = float(total.mean() - (energy @ shares)[2:].sum())
    noise = float((total.var() / HIGH_SEEDS + (shares[:, 2:].sum(1) * variance.sqrt()).sum() ** 2).sqrt())
    assert abs(off) < 4.0 * noise + 0.01 * float(total.mean())
