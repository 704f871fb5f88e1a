"""The fog, the light in it and the view, as the user of `cloudfit fog` states them."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from render.units import radians_from_degrees

if TYPE_CHECKING:
    from torch import Tensor

    from render.media import FogLight, LayeredMedium


@dataclass(frozen=True)
class FogChoice:
    """The fog, light and view as the user states them: metres and degrees."""

    medium: str
    visibility: float
    fog_height: float
    fog_base: float
    asymmetry: float
    albedo: float
    sun_azimuth: float
    sun_elevation: float
    sun_colour: str | None
    sun_intensity: float
    ambient: float
    eye_height: float
    camera_azimuth: float
    camera_elevation: float
    camera_fov: float

    def build_medium(self, factor: float = 1.0) -> "LayeredMedium":
        """The fog at a multiple of the visibility. Raises ParameterError where there is no such fog."""
        from render.media import ExponentialDecay, extinction_from_visibility, find_medium

        extinction = extinction_from_visibility(factor * self.visibility)
        make, base = find_medium(self.medium), self.fog_base
        if make is ExponentialDecay:
            return ExponentialDecay(extinction, self.fog_height, base, base)
        return make(extinction, base + self.fog_height, base)

    def sun(self) -> tuple["Tensor", "Tensor"]:
        """Unit vector towards the sun, and the radiance of a white surface that faces it."""
        import torch

        from render.camera import direction_from_angles
        from render.gradient_sky import sunlight_through_air

        elevation = radians_from_degrees(self.sun_elevation)
        colour = sunlight_through_air(elevation) if self.sun_colour is None else parse_colour(self.sun_colour)
        direction = direction_from_angles(radians_from_degrees(self.sun_azimuth), elevation)
        return torch.tensor(direction, dtype=torch.float64), self.sun_intensity * torch.tensor(
            colour, dtype=torch.float64
        )

    def light(self, sun: "Tensor", sunlight: "Tensor", ambient: "Tensor") -> "FogLight":
        """What the fog scatters; a white surface that faces the sun turns an irradiance E into a radiance E / pi."""
        from render.media import FogLight

        return FogLight(sun, math.pi * sunlight, self.ambient * ambient, self.asymmetry, self.albedo)

    def directions(self, width: int, height: int) -> "Tensor":
        """Unit directions of view `(height, width, 3)`."""
        from cloudfit.fog_picture import aim_camera, view_rays

        angles = (self.camera_azimuth, self.camera_elevation, self.camera_fov)
        azimuth, elevation, opening = map(radians_from_degrees, angles)
        return view_rays(aim_camera(azimuth, elevation, opening, (width, height)))


def parse_colour(text: str) -> tuple[float, float, float]:
    """Red, green and blue, from a text such as 1,0.9,0.8. Raises ParameterError for anything else."""
    from render.errors import ParameterError

    try:
        red, green, blue = (float(part) for part in text.split(","))
    except ValueError:
        raise ParameterError(f"expected a colour as red,green,blue, such as 1,0.9,0.8, got {text!r}") from None
    if not all(0.0 <= part < float("inf") for part in (red, green, blue)):
        raise ParameterError(f"expected a colour of finite numbers of at least 0, got {text!r}")
    return red, green, blue
