"""Reference path tracer and stack against the `volpath` integrator of Mitsuba 3, cumulatively over the scattering orders.

An independent implementation of the same physics: other code, other random numbers, other conventions of axes. Mitsuba averages over
the area of a pixel while our rays pass through pixel centres, so our images have twice its resolution, which makes the
difference negligible.
"""

import dataclasses
import math
from dataclasses import dataclass
from functools import lru_cache
from types import ModuleType

import numpy as np
import pytest
import torch
from torch import Tensor

from benchmarks.mitsuba_peer import mitsuba_scene
from precompute.error_budget import Effort
from precompute.scattering_orders import build_scattering_stack
from render.camera import PinholeCamera, direction_from_angles, frame_volume
from render.density_grid import DensityGrid
from render.path_tracer import trace_reference
from render.procedural_cloud import build_cumulus
from render.ray_march import compute_optical_length
from render.scattering_stack import ScatteringStack

pytestmark = pytest.mark.slow

ORDERS = 4
BATCHES = 8
MITSUBA_SAMPLES = 96
NO_ROULETTE = 1000
REFERENCE_SAMPLES = 32
STACKS = 2
LARGEST_DIFFERENCE = 0.01
LARGEST_STANDARD_ERROR = 0.0025


@dataclass(frozen=True)
class Case:
    """Asymmetry, and optical depth of the densest view ray."""

    asymmetry: float
    optical_depth: float


CASES = (Case(0.0, 6.0), Case(0.475, 30.0))


@dataclass(frozen=True)
class Estimate:
    """Mean radiance of the image for orders 1..k `(order,)` and its standard error, float64."""

    mean: Tensor
    standard_error: Tensor

    @classmethod
    def of_batches(cls, batches: Tensor) -> "Estimate":
        """From independent estimates `(batch, order)`."""
        return cls(batches.mean(0), batches.std(0) / math.sqrt(len(batches)))


@lru_cache(maxsize=1)
def cumulus() -> DensityGrid:
    return build_cumulus(64, seed=3)


def camera(width: int = 128, height: int = 96) -> PinholeCamera:
    view = frame_volume(cumulus(), width=width, height=height)
    assert isinstance(view, PinholeCamera)
    return view


SUN = direction_from_angles(math.radians(120.0), math.radians(40.0))


@lru_cache(maxsize=1)
def largest_optical_length() -> float:
    return float(compute_optical_length(cumulus(), *camera().rays()).max())


@pytest.fixture(scope="module")
def mitsuba() -> ModuleType:
    module = pytest.importorskip("mitsuba", reason="needs Mitsuba 3: pip install mitsuba")
    module.set_variant("scalar_rgb")
    return module


def mitsuba_images(mi: ModuleType, case: Case, orders: int) -> Tensor:
    """Independent images of orders 1..k `(batch, height, width)`."""
    extinction = case.optical_depth / largest_optical_length()
    scene = mitsuba_scene(mi, cumulus(), camera(64, 48), SUN, extinction, case.asymmetry, orders, NO_ROULETTE)
    images = [np.array(mi.render(scene, spp=MITSUBA_SAMPLES, seed=seed)) for seed in range(BATCHES)]
    return torch.from_numpy(np.stack(images))[..., 0].double()


@pytest.fixture(scope="module", params=CASES, ids=str)
def truth(request: pytest.FixtureRequest, mitsuba: ModuleType) -> tuple[Case, Estimate, Tensor]:
    """A case, Mitsuba's mean images, and its image of all orders `(height, width)`."""
    images = [mitsuba_images(mitsuba, request.param, orders) for orders in range(1, ORDERS + 1)]
    means = torch.stack([image.mean((1, 2)) for image in images], dim=1)
    return request.param, Estimate.of_batches(means), images[-1].mean(0)


def reference_orders(case: Case) -> Tensor:
    """Independent images of the single orders by the reference path tracer `(batch, order, pixel)`."""
    extinction = case.optical_depth / largest_optical_length()
    return torch.stack(
        [
            trace_reference(
                cumulus(),
                camera(),
                torch.tensor(SUN),
                extinction=extinction,
                asymmetry=case.asymmetry,
                albedo=1.0,
                orders=ORDERS,
                samples=REFERENCE_SAMPLES,
                seed=seed,
            ).orders
            for seed in range(BATCHES)
        ]
    ).double()


@lru_cache(maxsize=1)
def stacks() -> tuple[ScatteringStack, ...]:
    """Stacks of other seeds; the cases lie between their nodes."""
    asymmetry = torch.linspace(0.0, 0.9, 7)
    extinction = torch.logspace(math.log10(1.0), math.log10(80.0), 9) / largest_optical_length()
    effort = Effort(ORDERS, 100_000, 3_000_000, 16)
    tables = [
        build_scattering_stack(cumulus(), camera(), torch.tensor(SUN), asymmetry, extinction, effort, seed)
        for seed in range(STACKS)
    ]
    return tuple(ScatteringStack(table) for table in tables)


def compose_orders(stack: ScatteringStack, asymmetry: float, extinction: float) -> Tensor:
    """Mean images of orders 1..k `(order,)` as the stack composes them."""
    candidate = [torch.tensor([value]) for value in (asymmetry, extinction, 1.0)]
    means = []
    for orders in range(2, ORDERS + 1):
        traced = slice(orders - 1)
        tables = dataclasses.replace(
            stack.tables, multiple=stack.tables.multiple[traced], knots=stack.tables.knots[traced]
        )
        layers = ScatteringStack(tables)(*candidate)
        images = (layers.single, layers.single + layers.multiple) if orders == 2 else (layers.single + layers.multiple,)
        means += [image.double().sum() / (tables.width * tables.height) for image in images]
    return torch.stack(means)


def assert_equal_means(name: str, estimate: Estimate, truth: Estimate) -> None:
    ratio = estimate.mean / truth.mean
    error = ratio * torch.hypot(estimate.standard_error / estimate.mean, truth.standard_error / truth.mean)
    table = "\n".join(
        f"{name} orders 1..{order}: ratio of means {r:.4f} +- {e:.4f}"
        for order, (r, e) in enumerate(zip(ratio.tolist(), error.tolist(), strict=True), 1)
    )
    print(table)
    assert (error < LARGEST_STANDARD_ERROR).all(), f"too noisy to tell\n{table}"
    assert ((ratio - 1.0).abs() < LARGEST_DIFFERENCE).all(), table


def test_the_reference_path_tracer_agrees(truth: tuple[Case, Estimate, Tensor]) -> None:
    case, expected, image = truth
    orders = reference_orders(case)
    assert_equal_means(f"reference {case}", Estimate.of_batches(orders.cumsum(1).mean(2)), expected)
    ours = orders.mean(0).sum(0).reshape(48, 2, 64, 2).mean((1, 3))
    difference, mirrored = (float((picture - image).abs().mean() / image.mean()) for picture in (ours, ours.flip(1)))
    assert difference < 0.15 < 0.3 < mirrored, f"the images differ by {difference:.3f}, mirrored by {mirrored:.3f}"


def test_the_stack_agrees(truth: tuple[Case, Estimate, Tensor]) -> None:
    case, expected, _ = truth
    extinction = case.optical_depth / largest_optical_length()
    batches = torch.stack([compose_orders(stack, case.asymmetry, extinction) for stack in stacks()])
    assert_equal_means(f"stack {case}", Estimate.of_batches(batches), expected)


@pytest.mark.parametrize(("more_asymmetry", "extinction_factor"), [(0.05, 1.0), (0.0, 0.6)])
def test_other_parameters_are_noticed(
    truth: tuple[Case, Estimate, Tensor], more_asymmetry: float, extinction_factor: float
) -> None:
    case, expected, _ = truth
    extinction = extinction_factor * case.optical_depth / largest_optical_length()
    batches = torch.stack([compose_orders(stack, case.asymmetry + more_asymmetry, extinction) for stack in stacks()])
    with pytest.raises(AssertionError, match="ratio of means"):
        assert_equal_means("wrong", Estimate.of_batches(batches), expected)
