"""How much light is scattered twice and more often, which the methods of marching leave to the ambient light."""

import argparse
import math
from typing import Any

import torch
from rich.table import Table

from benchmarks.common import make_table
from render.camera import PinholeCamera, direction_from_angles
from render.media import Uniform
from render.shafts.air import Air, Constituent
from render.shafts.casters import make_ground, make_ridge, make_sphere
from render.shafts.lights import Sun
from render.shafts.mesh import Mesh
from render.shafts.path_tracer import trace_orders
from render.shafts.scene import ShaftScene
from render.shafts.stage import MapSettings, prepare_stage
from render.shafts.truth import compute_truth

DEPTHS = (0.1, 0.3, 1.0, 3.0)
"""Optical depths of the fog across the scene."""

ORDERS = 8

SAMPLES, QUICK_SAMPLES = 512, 4

SIZE = 100.0
"""Of the scene [m]; only the optical depths matter."""

CASTERS = {
    "sphere": lambda: make_sphere((0.0, 0.0, 0.35 * SIZE), 0.25 * SIZE),
    "ridge": lambda: make_ridge(5.0 * SIZE, SIZE, 0.6 * SIZE, 128),
}


def make_scene(caster: Mesh, depth: float, quick: bool) -> ShaftScene:
    """A thing before a low sun in uniform fog of an optical depth along twice the scene's size."""
    fog = Constituent(Uniform(depth / (2.0 * SIZE), SIZE, -math.inf), albedo=0.95, asymmetry=0.6)
    return ShaftScene(
        camera=PinholeCamera(
            (0.0, -2.0 * SIZE, 0.2 * SIZE), (0.0, 0.0, 0.35 * SIZE), 0.8, *((8, 6) if quick else (48, 27))
        ),
        meshes=(caster, make_ground(20.0 * SIZE)),
        air=Air((fog,)),
        sun=Sun(direction_from_angles(math.radians(8.0), math.radians(18.0))),
        reach=4.0 * SIZE,
    )


def measure_orders(arguments: argparse.Namespace) -> tuple[Any, tuple[Table, ...]]:
    """Mean light of every order over that of the first, and what an ambient light would have to be to stand for them."""
    found = []
    for name, make in CASTERS.items():
        for depth in DEPTHS[1:3] if arguments.quick else DEPTHS:
            found.append(
                {
                    "scene": name,
                    "depth": depth,
                    **measure_scene(make_scene(make(), depth, arguments.quick), arguments.quick),
                }
            )
    rows = [
        (
            f"{one['scene']}, optical depth {one['depth']:g}",
            *(f"{share:.1%}" for share in one["shares"][1:4]),
            f"{sum(one['shares'][4:]):.1%}",
            f"{one['missing']:.1%}",
            f"{one['ambient']:.3g} [{one['ambient_lower']:.3g}, {one['ambient_upper']:.3g}]",
            f"{one['first_against_truth']:.2%} of {one['first_noise']:.2%}",
        )
        for one in found
    ]  # fmt: skip
    columns = (
        "scene",
        "order 2",
        "order 3",
        "order 4",
        "orders 5-8",
        "in all",
        "as ambient light",
        "order 1, off, noise",
    )
    title = "light of more scatterings as a share of the first, and the ambient light that stands for it (irradiance of the sun = 1)"
    return found, (make_table(title, columns, rows),)


def measure_scene(scene: ShaftScene, quick: bool) -> dict[str, Any]:
    """Orders of one scene.

    An ambient radiance L adds L albedo (1 - transmittance) to a pixel. `ambient` is the one that gives the higher orders
    their mean over the picture; its bounds are the quartiles of those that single pixels would need.
    """
    stage = prepare_stage(scene, MapSettings(exact=True))
    traced = trace_orders(stage, ORDERS, QUICK_SAMPLES if quick else SAMPLES)
    truth = compute_truth(stage, 1e-2 if quick else 3e-4).in_scattering[:, 0].double()
    means = traced.mean.mean(1)
    more = traced.mean[1:].sum(0)
    rays = stage.rays
    depth = scene.air.compute_depth(rays.origin[:, 2], rays.direction[:, 2], rays.distance)[:, 0].double()
    scattered = -scene.air.constituents[0].albedo * torch.expm1(-depth)
    low, high = (float((more / scattered).quantile(share)) for share in (0.25, 0.75))
    noise = float(traced.variance[0].sum().sqrt()) / len(truth)
    return {
        "shares": (means / means[0]).tolist(),
        "missing": float(more.mean() / means[0]),
        "ambient": float(more.mean() / scattered.mean()),
        "ambient_lower": low,
        "ambient_upper": high,
        "first_against_truth": float((means[0] - truth.mean()).abs() / truth.mean()),
        "first_noise": noise / float(truth.mean()),
        "samples": traced.samples,
    }
