"""A candidate rendered by itself: all effort on one asymmetry and one extinction, at full size."""

import time
from dataclasses import dataclass

import torch
from torch import Tensor

from cloudfit.air_search import Comparison, HazeSearch
from cloudfit.fit_problem import resize_image, visible_share
from cloudfit.fit_types import AIR_REFINEMENTS, Picture
from cloudfit.losses import L1
from cloudfit.scene import Scene
from precompute.error_budget import Effort
from precompute.scattering_orders import Progress, build_scattering_stack
from render.cloud_image import Lighting, compose_cloud
from render.scattering_stack import CloudLayers, ScatteringStack


@dataclass(frozen=True, eq=False)
class AirBefore:
    """What the air makes of the light of a cloud; each `(channel,)` or `(height, width, channel)`.

    Args:
        sunlight: irradiance of the cloud by the sun, dimmed by the air between cloud and camera.
        ambient: radiance of an opaque cloud in the ambient light, dimmed likewise.
        light: that the air between cloud and camera adds.
        visible: share of a cloud that nothing nearer hides `(height, width)`, or a number [1].
    """

    sunlight: Tensor
    ambient: Tensor
    light: Tensor
    visible: Tensor | float = 1.0


class CandidateRendering:
    """Cloud layers of one candidate, for any lighting, sky and air.

    Args:
        scene: volume, camera and sun.
        parameters: `asymmetry`, `extinction` [1/m], `albedo`, `sunlight_intensity` and `ambient` by name.
        effort: of the rendering.
        seed: of the random streams.
        on_progress: called with a stage and the share of it that is done.
    """

    def __init__(
        self,
        scene: Scene,
        parameters: dict[str, float],
        effort: Effort,
        seed: int = 0,
        on_progress: Progress = lambda stage, share: None,
    ) -> None:
        started = time.perf_counter()
        self.scene, self.parameters = scene, parameters
        asymmetry, extinction, albedo = (
            torch.tensor([parameters[name]]) for name in ("asymmetry", "extinction", "albedo")
        )
        tables = build_scattering_stack(
            scene.grid,
            scene.camera,
            scene.sun_direction,
            asymmetry,
            extinction,
            effort,
            seed,
            on_progress,
            (float(albedo),),
        )
        stack = ScatteringStack(tables)
        with torch.no_grad():
            self.layers: CloudLayers = stack(asymmetry, extinction, albedo)
        self.pixel, self.optical_length = tables.pixel, tables.optical_length
        self.groups = tables.groups
        self.image_error = float(tables.image_error[0, 0])
        self.seconds = time.perf_counter() - started

    def lighting(self, sunlight_colour: Tensor, ambient_colour: Tensor) -> Lighting:
        """Light of the candidate; colours `(channel,)`."""
        intensity, ambient = (torch.tensor([self.parameters[name]]) for name in ("sunlight_intensity", "ambient"))
        return Lighting(intensity, sunlight_colour, ambient, ambient_colour)

    @property
    def counted(self) -> Tensor:
        """Numbers of the pixels of the picture that are compared with the photograph `(pixel,)`."""
        return self.pixel[visible_share(self.optical_length)]

    def search_air(
        self,
        lighting: Lighting,
        sky: Tensor,
        target: Tensor,
        display_curve: str,
        refinements: int = AIR_REFINEMENTS,
    ) -> HazeSearch:
        """Best air for this picture by the L1 loss.

        Args:
            lighting: of the candidate.
            sky: `(height, width, channel)` at the camera's size.
            target: the photograph's histogram `(channel, bin)`.
            display_curve: "srgb" or "none".
            refinements: of the search; 0 is the paper's.
        """
        return self.compare(lighting, sky, Comparison(L1, target, target, display_curve), refinements)

    def compare(
        self,
        lighting: Lighting,
        sky: Tensor,
        comparison: Comparison,
        refinements: int = AIR_REFINEMENTS,
        thirds: bool = False,
    ) -> HazeSearch:
        """Best air for this picture by any loss.

        Args:
            lighting: of the candidate.
            sky: `(height, width, channel)` at the camera's size.
            comparison: with the photograph, made for the `counted` pixels of this picture.
            refinements: of the search; 0 is the paper's.
            thirds: whether the search begins with every third depth.
        """
        behind = sky.flatten(0, 1)[self.pixel].T
        cloud = compose_cloud(self.layers, lighting, behind)
        counted = visible_share(self.optical_length)
        return comparison.search(cloud[:, :, counted], behind[:, counted], refinements, thirds)

    def picture(self, lighting: Lighting, sky: Tensor, air_depth: Tensor) -> Picture:
        """The picture with its layers; `air_depth` `(channel,)`."""
        share = torch.exp(-air_depth.to(torch.float32))
        sunlight = lighting.sunlight_colour * lighting.sunlight_intensity
        ambient = lighting.ambient_colour.reshape(3) * lighting.ambient
        return self.picture_in_air(AirBefore(share * sunlight, share * ambient, (1.0 - share) * sky), sky)

    def picture_in_air(self, air: AirBefore, sky: Tensor) -> Picture:
        """The picture with its layers through any air; sky `(height, width, channel)`.

        The sky holds the light of the air all along its rays, so in front of it only the share that the cloud hides is added:
        image = sunlit + ambient + (1 - T) air + T sky.
        """
        camera = self.scene.camera

        def spread(values: Tensor, fill: float = 0.0) -> Tensor:
            image = torch.full((camera.height * camera.width,), fill)
            image[self.pixel] = values
            return image.unflatten(0, (camera.height, camera.width))

        single = (spread(self.layers.single[0]) * air.visible)[..., None] * air.sunlight
        multiple = (spread(self.layers.multiple[0]) * air.visible)[..., None] * air.sunlight
        diffuse = (spread(self.layers.opacity[0]) * air.visible)[..., None] * air.ambient
        transmittance = 1.0 - (1.0 - spread(self.layers.transmittance[0], 1.0)) * air.visible
        behind = transmittance[..., None] * sky + (1.0 - transmittance[..., None]) * air.light
        return Picture(
            single + multiple + diffuse + behind,
            single,
            multiple,
            diffuse,
            behind,
            transmittance,
            self.image_error,
            self.seconds,
        )


def render_picture(
    scene: Scene,
    parameters: dict[str, float],
    air_depth: tuple[float, float, float],
    sunlight_colour: Tensor,
    ambient_colour: Tensor,
    sky: Tensor,
    effort: Effort,
    seed: int = 0,
    on_progress: Progress = lambda stage, share: None,
) -> Picture:
    """Render fitted parameters in any scene.

    Args:
        scene: volume, camera and sun.
        parameters: searched parameters by name, in units.
        air_depth: optical depth of the air, red, green, blue.
        sunlight_colour, ambient_colour: `(channel,)`, largest channel 1.
        sky: `(height, width, channel)` of any size.
        effort: of the rendering.
        seed: of the random streams.
        on_progress: called with a stage and the share of it that is done.

    Returns:
        The picture at the camera's size.
    """
    rendering = CandidateRendering(scene, parameters, effort, seed, on_progress)
    behind = resize_image(sky, scene.camera.width, scene.camera.height)
    return rendering.picture(rendering.lighting(sunlight_colour, ambient_colour), behind, torch.tensor(air_depth))
