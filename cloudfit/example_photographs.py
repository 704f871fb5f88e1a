"""Example photographs that the project renders itself, so that the main job can be tried without a photograph at hand.

Each is a procedural cumulus of its own under a simple gradient sky, path traced by the reference path tracer: another cloud, another
view, another sun and another renderer than the fit uses. Nothing in them is a real photograph, and their names say so.

The package carries them ready-made, since a hundred paths a pixel take minutes; `python -m cloudfit.example_photographs FOLDER` renders
them again.
"""

import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from render.camera import direction_from_angles, frame_volume
from render.image_files import write_png
from render.path_tracer import trace_reference
from render.procedural_cloud import build_cumulus
from render.ray_march import compute_optical_length
from render.units import radians_from_degrees

WIDTH, HEIGHT = 400, 300
RESOLUTION = 112
SAMPLES = 192
ORDERS = 16

READY_MADE = Path(__file__).parent / "examples"
"""Folder of the package that holds the rendered PNG files."""

Colour = tuple[float, float, float]


@dataclass(frozen=True)
class Example:
    """One made-up photograph; angles in degrees, colours linear with display white at 1.

    Args:
        name: of the file.
        cloud_seed: of the procedural cumulus.
        sun_azimuth_deg, sun_elevation_deg: direction of the sun.
        view_azimuth_deg: direction of the camera.
        optical_depth: of the densest view ray.
        asymmetry, albedo: of the cloud.
        sunlight: colour times intensity.
        ambient: radiance of an opaque cloud without sun.
        zenith, horizon: colours at the top and the bottom of the sky.
        air_depth: optical depth of the air in front of the cloud, red, green, blue.
    """

    name: str
    cloud_seed: int
    sun_azimuth_deg: float
    sun_elevation_deg: float
    view_azimuth_deg: float
    optical_depth: float
    asymmetry: float
    albedo: float
    sunlight: Colour
    ambient: Colour
    zenith: Colour
    horizon: Colour
    air_depth: Colour


EXAMPLES = (
    Example(
        name="rendered_noon",
        cloud_seed=11,
        sun_azimuth_deg=150.0,
        sun_elevation_deg=55.0,
        view_azimuth_deg=20.0,
        optical_depth=35.0,
        asymmetry=0.5,
        albedo=0.998,
        sunlight=(7.4, 7.2, 6.9),
        ambient=(0.12, 0.15, 0.2),
        zenith=(0.04, 0.13, 0.38),
        horizon=(0.28, 0.45, 0.68),
        air_depth=(0.02, 0.05, 0.1),
    ),
    Example(
        name="rendered_evening",
        cloud_seed=23,
        sun_azimuth_deg=215.0,
        sun_elevation_deg=24.0,
        view_azimuth_deg=0.0,
        optical_depth=25.0,
        asymmetry=0.6,
        albedo=0.99,
        sunlight=(8.2, 6.3, 4.2),
        ambient=(0.13, 0.15, 0.2),
        zenith=(0.05, 0.11, 0.3),
        horizon=(0.3, 0.4, 0.56),
        air_depth=(0.05, 0.1, 0.15),
    ),
    Example(
        name="rendered_against_the_light",
        cloud_seed=6,
        sun_azimuth_deg=30.0,
        sun_elevation_deg=50.0,
        view_azimuth_deg=10.0,
        optical_depth=14.0,
        asymmetry=0.7,
        albedo=0.995,
        sunlight=(5.0, 4.8, 4.5),
        ambient=(0.16, 0.19, 0.24),
        zenith=(0.06, 0.17, 0.42),
        horizon=(0.36, 0.5, 0.66),
        air_depth=(0.04, 0.08, 0.14),
    ),
)


def simple_sky(zenith: Colour, horizon: Colour, width: int, height: int) -> Tensor:
    """Vertical gradient `(height, width, channel)` that brightens towards the horizon as the air mass does."""
    height_above = (height - torch.arange(height, dtype=torch.float32) - 0.5) / height
    share = torch.exp(-2.5 * height_above)[:, None, None]
    sky = torch.tensor(zenith) * (1.0 - share) + torch.tensor(horizon) * share
    return sky.expand(height, width, 3).clone()


def render_example(example: Example, samples: int = SAMPLES, seed: int = 0) -> Tensor:
    """Linear image `(height, width, channel)` of one example, by the reference path tracer with `samples` paths a pixel."""
    grid = build_cumulus(RESOLUTION, example.cloud_seed)
    camera = frame_volume(grid, width=WIDTH, height=HEIGHT, azimuth=radians_from_degrees(example.view_azimuth_deg))
    sun = direction_from_angles(
        radians_from_degrees(example.sun_azimuth_deg), radians_from_degrees(example.sun_elevation_deg)
    )
    traced = trace_reference(
        grid,
        camera,
        torch.tensor(sun),
        extinction=example.optical_depth / float(compute_optical_length(grid, *camera.rays()).max()),
        asymmetry=example.asymmetry,
        albedo=example.albedo,
        orders=ORDERS,
        samples=samples,
        seed=seed,
    )
    transmittance = traced.transmittance[:, None]
    sky = simple_sky(example.zenith, example.horizon, WIDTH, HEIGHT).reshape(-1, 3)
    lit = traced.radiance[:, None] * torch.tensor(example.sunlight) + (1.0 - transmittance) * torch.tensor(
        example.ambient
    )
    air = torch.exp(-torch.tensor(example.air_depth))
    return (air * (lit + transmittance * sky) + (1.0 - air) * sky).reshape(HEIGHT, WIDTH, 3)


def write_examples(folder: Path) -> list[Path]:
    """Copy the ready-made examples into a folder, made if needed; returns their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    return [Path(shutil.copy(READY_MADE / f"{example.name}.png", folder)) for example in EXAMPLES]


def render_examples(folder: Path, on_progress: Callable[[str], None] = lambda name: None) -> None:
    """Render all examples anew, as 8-bit PNG files with the sRGB curve."""
    folder.mkdir(parents=True, exist_ok=True)
    for example in EXAMPLES:
        on_progress(example.name)
        write_png(folder / f"{example.name}.png", render_example(example))


if __name__ == "__main__":
    render_examples(Path(sys.argv[1]), lambda name: print(f"rendering {name}", file=sys.stderr))
