"""Mitsuba 3 as a peer: the same cloud, camera and sun in its `volpath` integrator, its time and its noise."""

import importlib
import math
from dataclasses import dataclass
from importlib.util import find_spec
from types import ModuleType

import numpy as np
import torch
from torch import Tensor

from benchmarks.common import stopwatch
from benchmarks.parameter_sets import ParameterSet, largest_optical_length
from cloudfit.scene import Scene
from render.camera import PinholeCamera
from render.density_grid import DensityGrid
from render.ray_march import compute_optical_length

VARIANTS = ("scalar_rgb", "llvm_ad_mono", "llvm_ad_rgb")

ROULETTE_DEPTH = 5
"""From which depth Mitsuba ends paths by Russian roulette: its own default."""


@dataclass(frozen=True)
class PeerCost:
    """One image of one node.

    Args:
        variant: of Mitsuba.
        node: asymmetry, optical depth and albedo of the image.
        samples: paths a pixel.
        first_seconds: of a first image, with whatever is compiled for it.
        seconds: of an image after that, mean of two.
        error: relative RMS noise of one image over the cloud pixels, from the difference of two.
    """

    variant: str
    node: ParameterSet
    samples: int
    first_seconds: float
    seconds: float
    error: float

    def seconds_for(self, error: float) -> float:
        """Seconds for an image with another error: noise falls with the root of the number of paths."""
        return self.seconds * (self.error / error) ** 2


def find_mitsuba(threads: int) -> ModuleType | None:
    """Mitsuba with so many threads, where it is installed."""
    if find_spec("mitsuba") is None:
        return None
    mitsuba = importlib.import_module("mitsuba")
    importlib.import_module("drjit").set_thread_count(threads)
    return mitsuba


def mitsuba_scene(
    mi: ModuleType,
    grid: DensityGrid,
    camera: PinholeCamera,
    sun_direction: tuple[float, float, float],
    extinction: float,
    asymmetry: float,
    orders: int,
    roulette_depth: int,
) -> object:
    """The scene for the variant that is set, albedo one; a path of k scatterings has the depth k + 1 there."""
    transform = mi.ScalarTransform4f()
    lower, extent = grid.lower.tolist(), (grid.upper - grid.lower).tolist()
    medium = {
        "type": "heterogeneous",
        "albedo": {"type": "constvolume", "value": 1.0},
        "sigma_t": {
            "type": "gridvolume",
            "grid": mi.VolumeGrid(grid.density.numpy()[..., None]),
            "raw": True,
            "filter_type": "trilinear",
            "wrap_mode": "clamp",
            "to_world": transform.translate(lower).scale(extent),
        },
        "scale": extinction,
        "phase": {"type": "hg", "g": asymmetry},
    }
    box = transform.translate(grid.centre.tolist()).scale([0.5 * edge for edge in extent])
    film = {
        "type": "hdrfilm",
        "width": camera.width,
        "height": camera.height,
        "rfilter": {"type": "box"},
        "pixel_format": "luminance",
    }
    sensor = {
        "type": "perspective",
        "fov": math.degrees(camera.field_of_view),
        "fov_axis": "y",
        "near_clip": 1e-3 * grid.radius,
        "far_clip": 1e2 * grid.radius,
        "to_world": transform.look_at(origin=camera.position, target=camera.target, up=camera.up),
        "film": film,
        "sampler": {"type": "independent"},
    }
    sun = {
        "type": "directional",
        "direction": [-component for component in sun_direction],
        "irradiance": {"type": "rgb", "value": 1.0},
    }
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "volpath", "max_depth": orders + 1, "rr_depth": roulette_depth},
            "sensor": sensor,
            "sun": sun,
            "cloud": {"type": "cube", "to_world": box, "bsdf": {"type": "null"}, "interior": medium},
        }
    )


def measure_peer(mi: ModuleType, variant: str, scene: Scene, node: ParameterSet, orders: int, samples: int) -> PeerCost:
    """Time and noise of one node.

    Raises:
        RuntimeError: where the variant does not work here, for want of LLVM for example.
    """
    try:
        mi.set_variant(variant)
    except (AttributeError, ImportError) as error:
        raise RuntimeError(str(error)) from error
    camera = scene.camera
    if not isinstance(camera, PinholeCamera):
        raise RuntimeError("the camera is no pinhole camera")
    extinction = node.optical_depth / largest_optical_length(scene.grid, camera)
    x, y, z = scene.sun_direction.tolist()
    loaded = mitsuba_scene(mi, scene.grid, camera, (x, y, z), extinction, node.asymmetry, orders, ROULETTE_DEPTH)
    pixel = torch.nonzero(compute_optical_length(scene.grid, *camera.rays()) > 0).flatten()

    def render(seed: int) -> tuple[Tensor, float]:
        with stopwatch() as seconds:
            image = np.array(mi.render(loaded, spp=samples, seed=seed))
        return torch.from_numpy(image).flatten()[pixel].double(), seconds[0]

    (_, first), (one, one_seconds), (other, other_seconds) = (render(seed) for seed in range(3))
    noise = ((one - other).square().mean() / 2.0).sqrt() / (one * other).mean().clamp(min=1e-300).sqrt()
    return PeerCost(variant, node, samples, first, 0.5 * (one_seconds + other_seconds), float(noise))
