"""A thick cloud that absorbs next to nothing: orders up to the 258th against paths of 256 scatterings."""

import pytest
import torch

from precompute.error_budget import Effort
from precompute.scattering_orders import build_scattering_stack
from render.camera import frame_volume
from render.path_tracer import trace_reference
from render.procedural_cloud import build_cumulus
from render.ray_march import compute_optical_length
from render.scattering_stack import ScatteringStack
from tests.support.volumes import towards

OPTICAL_DEPTH, ALBEDO = 60.0, 0.999
ORDERS = 256

ACCEPTED = 0.02
"""Relative difference of the mean image."""

EFFORT = Effort(258, 40_000, 2_000_000, 16, True)


@pytest.mark.slow
@pytest.mark.parametrize("asymmetry", [0.0, 0.85])
def test_the_mean_image_is_that_of_paths_to_order_256(asymmetry: float) -> None:
    grid = build_cumulus(48, seed=1)
    camera = frame_volume(grid, width=32, height=24)
    extinction = OPTICAL_DEPTH / float(compute_optical_length(grid, *camera.rays()).max())
    sun = towards(110.0, 25.0)
    nodes = torch.tensor([asymmetry]), torch.tensor([extinction])
    reference = trace_reference(
        grid, camera, sun, extinction=extinction, asymmetry=asymmetry, albedo=ALBEDO, orders=ORDERS, samples=3000
    )
    means = {}
    for name, effort in (("tail", EFFORT), ("no tail", Effort(258, 40_000, 2_000_000, 16, False))):
        stack = ScatteringStack(build_scattering_stack(grid, camera, sun, *nodes, effort, 1, albedo=(ALBEDO,)))
        layers = stack(*nodes, torch.tensor([ALBEDO]))
        means[name] = float((layers.single + layers.multiple).double().mean())
    truth = float(reference.radiance[stack.pixel].double().mean())
    noise = float(reference.radiance_variance[stack.pixel].double().sum().sqrt()) / len(stack.pixel) / truth
    print(f"g {asymmetry}: { ({n: m / truth - 1 for n, m in means.items()}) } +- {noise:.4f} of the mean image")
    assert noise < 0.3 * ACCEPTED
    assert abs(means["tail"] / truth - 1.0) < ACCEPTED
    assert means["no tail"] < means["tail"]
