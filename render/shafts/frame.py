"""The one result of every method: the image and its parts, what was modelled, and what that took."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from render.shafts.methods.base import Gathered, Method
from render.shafts.scene import ShaftScene
from render.shafts.stage import Clock, MapSettings, Stage, prepare_stage


@dataclass(frozen=True, eq=False)
class Frame:
    """A picture with air.

        radiance = transmittance background + in_scattering + ambient

    Args:
        radiance: the image `(height, width, channel)`, linear light.
        in_scattering: light of sun and lamps that the air adds `(height, width, channel)`.
        ambient: light from everywhere that the air adds `(height, width, channel)`.
        transmittance: of the air in front of what is seen `(height, width, channel)` [1].
        background: what is seen without air `(height, width, channel)`.
        distance: to what is seen, or the reach of the scene `(height, width)` [m].
        modelled: sentences about what was computed.
        skipped: sentences about what the scene did not require, and why.
        seconds: by part [s].
    """

    radiance: Tensor
    in_scattering: Tensor
    ambient: Tensor
    transmittance: Tensor
    background: Tensor
    distance: Tensor
    modelled: tuple[str, ...]
    skipped: tuple[str, ...]
    seconds: Mapping[str, float]

    def layers(self) -> dict[str, Tensor]:
        """Layers of an EXR file by name."""
        return {
            "rgb": self.radiance,
            "in_scattering": self.in_scattering,
            "ambient": self.ambient,
            "transmittance": self.transmittance,
            "background": self.background,
            "distance": self.distance,
        }


def render_frame(scene: ShaftScene, method: Method, maps: MapSettings | None = None) -> Frame:
    """Render a scene.

    Args:
        scene: what is to be rendered.
        method: how the in-scattered light is gathered.
        maps: how shadows are found; None for maps of the usual sizes.

    Returns:
        The frame.

    Raises:
        MissingExtraError: the scene has meshes, and embreex is not installed.
    """
    return compose_frame(prepare_stage(scene, maps), method)


def compose_frame(stage: Stage, method: Method) -> Frame:
    """Gather the light of a scene that is ready, and compose the picture.

    Args:
        stage: the scene.
        method: how the in-scattered light is gathered.

    Returns:
        The frame; its seconds are those of the stage and those of the method.
    """
    clock = Clock(dict(stage.seconds))
    with clock.timed("gathering light"):
        gathered = method.gather(stage)
    with clock.timed("composition"):
        layers = _compose(stage, gathered)
    size = stage.scene.camera.height, stage.scene.camera.width
    shaped = {name: layer.unflatten(0, size) for name, layer in layers.items()}
    return Frame(
        radiance=shaped["radiance"],
        in_scattering=shaped["in_scattering"],
        ambient=shaped["ambient"],
        transmittance=shaped["transmittance"],
        background=stage.background.unflatten(0, size),
        distance=stage.depth_buffer,
        modelled=gathered.modelled,
        skipped=gathered.skipped,
        seconds={**clock.seconds, **{f"  {part}": spent for part, spent in gathered.seconds.items()}},
    )


def _compose(stage: Stage, gathered: Gathered) -> dict[str, Tensor]:
    scene, rays = stage.scene, stage.rays
    depth, scattered = scene.air.compute_ray_depths(rays)
    transmittance = torch.exp(-depth)
    ambient = torch.zeros_like(depth)
    if any(scene.ambient):
        albedo = torch.where(depth > 0.0, scattered / torch.where(depth > 0.0, depth, 1.0), 0.0)
        ambient = -albedo * torch.expm1(-depth) * depth.new_tensor(scene.ambient)
    radiance = transmittance * stage.background + gathered.in_scattering + ambient
    return {
        "radiance": radiance,
        "in_scattering": gathered.in_scattering,
        "ambient": ambient,
        "transmittance": transmittance,
    }
