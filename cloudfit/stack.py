"""The stack of a fit: which nodes the search box needs, and how accurate they came out."""

from pathlib import Path

import torch

from cloudfit.parameters import ASYMMETRY_RANGE, LARGEST_OPTICAL_DEPTH_RANGE
from cloudfit.quality import Quality
from cloudfit.scene import Scene
from precompute.scattering_orders import Progress
from precompute.stack_store import StackReport, load_or_build_stack
from render.errors import CameraError
from render.ray_march import compute_optical_length
from render.scattering_stack import ScatteringStack


def prepare_stack(
    scene: Scene,
    quality: Quality,
    seed: int = 0,
    folder: Path | None = None,
    on_progress: Progress = lambda stage, share: None,
    optical_depths: tuple[float, float] = LARGEST_OPTICAL_DEPTH_RANGE,
) -> tuple[ScatteringStack, StackReport]:
    """Build or load the stack that covers the whole search box.

    Args:
        scene: volume, camera and sun.
        quality: effort, nodes and accepted error.
        seed: of the random streams.
        folder: where stacks are kept, or None.
        on_progress: called with a stage and the share of it that is done.
        optical_depths: of the densest view ray, thinnest and thickest; the narrower, the sooner it is done.

    Returns:
        The stack and where it came from.

    Raises:
        CameraError: if the camera sees no cloud.
        ParameterError: for optical depths that do not rise from above zero.
    """
    width = max(1, round(scene.camera.width * quality.table_scale))
    height = max(1, round(scene.camera.height * quality.table_scale))
    camera = scene.camera.resized(width, height)
    largest = float(compute_optical_length(scene.grid, *camera.rays()).max())
    if largest <= 0.0:
        raise CameraError(
            "the camera sees no cloud: every view ray misses it or the volume is empty; move the camera or the volume"
        )
    extinction = (quality.place_depths(*optical_depths) / largest).float()
    asymmetry = torch.linspace(*ASYMMETRY_RANGE, quality.asymmetry_nodes)
    tables, report = load_or_build_stack(
        folder, scene.grid, camera, scene.sun_direction, asymmetry, extinction, quality.table_effort, seed, on_progress
    )
    return ScatteringStack(tables, quality.largest_image_error), report
