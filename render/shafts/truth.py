"""The truth about a scene, how far a method is from it, and settings that keep within a tolerance."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from render.errors import ParameterError
from render.shafts.march import ShadowLooks
from render.shafts.methods.adaptive import Adaptive
from render.shafts.methods.base import Method
from render.shafts.scene import ShaftScene
from render.shafts.stage import MapSettings, Stage, prepare_stage

FIRST_STEPS, MOST_STEPS = 16, 1 << 13
"""Steps that the truth begins with, and at which it gives up."""

SETTLED, SETTLED_STEPS = 0.25, 64
"""Share of the accepted change below which a single ray is left, and the steps before which none is: thin shadows are found late."""

LOOKS = ShadowLooks(4, 8)
"""For shadows, in each step of the truth."""

MOST_REFINEMENTS = 6
"""After which no settings are refined any further."""


@dataclass(frozen=True)
class LightError:
    """How far one image of in-scattered light is from another.

    Args:
        relative_rms: root mean square of the difference over that of the true image [1].
        largest: largest difference over the largest value of the true image [1].
    """

    relative_rms: float
    largest: float


def measure_error(light: Tensor, truth: Tensor) -> LightError:
    """Error of light against the truth, both of one shape; 0 for equal ones, black ones included."""
    difference = (light.double() - truth.double()).abs()
    power, peak = float(truth.double().square().mean().sqrt()), float(truth.double().max())
    rms, largest = float(difference.square().mean().sqrt()), float(difference.max())
    if peak == 0.0:
        return LightError(*((0.0, 0.0) if largest == 0.0 else (float("inf"), float("inf"))))
    return LightError(rms / power, largest / peak)


@dataclass(frozen=True, eq=False)
class Truth:
    """Converged light.

    Args:
        in_scattering: `(pixel, channel)`.
        steps: along the rays that needed most.
        change: relative RMS by which the last doubling changed it [1].
    """

    in_scattering: Tensor
    steps: int
    change: float


def compute_truth(stage: Stage, change: float = 1e-3) -> Truth:
    """The march along every pixel's ray, its steps doubled until that changes little.

    Each step looks for shadows at the ends of four parts, and halves the borders in. So the steps of a truth are few, but no ray
    is interpolated and nothing is left early. A ray whose light has settled, to a quarter of the change that the image may have, is not
    marched again: its last change stays in the sum.

    Args:
        stage: the scene; the shadows of its maps are taken as they are.
        change: relative RMS that a doubling may still make [1].

    Returns:
        The light of the last doubling.

    Raises:
        ParameterError: where 8192 steps are too few.
    """
    steps = FIRST_STEPS
    light = _march_everything(stage, steps)
    last = torch.zeros(len(light), dtype=torch.float64)
    active = torch.arange(len(light))
    while steps < MOST_STEPS:
        steps *= 2
        after = _march_everything(stage.with_rays(active), steps)
        last[active] = (after - light[active]).double().square().sum(1)
        light[active] = after
        power = float(light.double().square().sum(1).mean())
        changed = math.sqrt(float(last.mean()) / power) if power > 0.0 else 0.0
        if changed < change:
            return Truth(light, steps, changed)
        if steps >= SETTLED_STEPS:
            active = active[last[active] > (SETTLED * change) ** 2 * power]
    raise ParameterError(f"the light still changes by more than {change:g} at {MOST_STEPS} steps along every ray")


def _march_everything(stage: Stage, steps: int) -> Tensor:
    """Light of steps along the ray of every pixel: equal ones for the sun, shorter ones near a lamp, whose glow equal ones miss."""
    method = Adaptive(
        steps, LOOKS, factor=1, lines=None, contrast=math.inf, spent=0.0, lamp_steps=steps, lamp_looks=LOOKS
    )
    return method.gather(stage).in_scattering


@dataclass(frozen=True)
class Chosen:
    """Settings that keep within a tolerance, and what that was judged by.

    Args:
        method: the settings.
        error: on the coarse picture.
        refinements: how often they were refined.
    """

    method: Method
    error: LightError
    refinements: int


def choose_settings(
    scene: ShaftScene, method: Method, tolerance: float, maps: MapSettings | None = None, width: int = 192
) -> Chosen:
    """Refine a method until a coarse picture of the scene keeps within a tolerance.

    A method that fills up pixels errs more in a coarse picture, whose pixels differ more, so the settings are on the safe side.

    Args:
        scene: what is to be rendered.
        method: to begin with.
        tolerance: accepted relative RMS error of the in-scattered light [1].
        maps: how shadows are found.
        width: of the coarse picture [pixel]; a smaller scene is taken as it is.

    Returns:
        The coarsest settings within half the tolerance, or the finest there are.

    Raises:
        ParameterError: for a tolerance that is not positive.
    """
    if not tolerance > 0.0:
        raise ParameterError(f"expected a positive tolerance, got {tolerance}")
    camera = scene.camera
    small = min(width, camera.width)
    stage = prepare_stage(scene.resized(small, max(1, round(small * camera.height / camera.width))), maps)
    truth = compute_truth(stage, min(1e-3, 0.1 * tolerance)).in_scattering
    for number in range(MOST_REFINEMENTS + 1):
        error = measure_error(method.gather(stage).in_scattering, truth)
        if error.relative_rms <= 0.5 * tolerance or number == MOST_REFINEMENTS:
            break
        method = method.refined()
    return Chosen(method, error, number)
