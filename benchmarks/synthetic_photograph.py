"""Photographs whose parameters are known: a cloud under a smooth sky, composed here from scattered light and transmittance.

    pixel(c) = a(c) [ c_in(c) L_in grey + c_in(c) ambient (1 - T) + T L_sky(c) ] + (1 - a(c)) L_sky(c),    a(c) = exp(-air_depth(c))

Grey light and transmittance T come from the reference path tracer where the photograph is to be an independent truth.
"""

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from cloudfit.analysis import PhotographAnalysis, analyse_photograph
from cloudfit.cloud_mask import CloudMask, Label
from cloudfit.fit_problem import visible_share
from cloudfit.photograph import Photograph, read_photograph
from cloudfit.scene import Scene
from cloudfit.sunlight import Sunlight
from precompute.error_budget import Effort
from precompute.scattering_orders import build_scattering_stack
from precompute.store import table_key
from render.camera import Camera
from render.colour import srgb_to_linear
from render.image_files import write_mask_png, write_png
from render.path_tracer import ReferenceImage, trace_reference
from render.ray_march import compute_optical_length
from render.scattering_stack import ScatteringStack

HORIZON, ZENITH = (0.55, 0.70, 0.86), (0.13, 0.30, 0.66)
"""Linear light of the sky at the bottom and the top of the image."""

BRIGHT_SHARE = 0.95
"""Share of the cloud pixels that are darker than the bright level."""

PILOT_SAMPLES, LEAST_SAMPLES = 32, 4

ORDERS = 4


@dataclass(frozen=True)
class Truth:
    """Parameters of a synthetic photograph.

    Args:
        optical_depth: of the densest view ray.
        asymmetry, albedo, ambient: as in the search space.
        bright_level: display level 0..1 of the bright clouds, before the air; it fixes the sunlight's intensity.
        sunlight_colour: red, green, blue, largest 1.
        air_depth: optical depth of the air, red, green, blue.
        sunlight_intensity: once the photograph has been rendered.
    """

    optical_depth: float
    asymmetry: float
    albedo: float
    ambient: float
    bright_level: float
    sunlight_colour: tuple[float, float, float]
    air_depth: tuple[float, float, float]
    sunlight_intensity: float = float("nan")


MIDDLE = Truth(15.0, 0.5, 0.95, 0.1, 0.8, (1.0, 0.98, 0.94), (0.1, 0.1, 0.2))
"""An ordinary cloud."""


def draw_truth(generator: torch.Generator) -> Truth:
    """Random parameters over the range that photographs of cumulus call for."""

    def uniform(low: float, high: float) -> float:
        return low + (high - low) * float(torch.rand((), generator=generator, dtype=torch.float64))

    return Truth(
        optical_depth=2.0 * 30.0 ** uniform(0.0, 1.0),
        asymmetry=uniform(0.0, 0.85),
        albedo=uniform(0.8, 1.0),
        ambient=uniform(0.0, 0.3),
        bright_level=uniform(0.75, 0.85),
        sunlight_colour=(1.0, uniform(0.92, 1.0), uniform(0.82, 0.98)),
        air_depth=(uniform(0.0, 0.6), uniform(0.0, 0.6), uniform(0.0, 0.6)),
    )


def sky_gradient(width: int, height: int) -> Tensor:
    """Smooth blue sky `(height, width, channel)`, linear light."""
    rise = ((torch.arange(height, dtype=torch.float32) + 0.5) / height)[:, None, None]
    return (torch.tensor(ZENITH) * (1.0 - rise) + torch.tensor(HORIZON) * rise).expand(height, width, 3).contiguous()


@dataclass(frozen=True, eq=False)
class SyntheticPhotograph:
    """A photograph file and all that is known about it.

    Args:
        path: 8-bit PNG.
        truth: its parameters, intensity included.
        cloud: `(height, width)` bool, which pixels are cloud.
        sky: `(height, width, channel)` linear light behind the cloud.
        noise: median over the cloud pixels of their relative standard deviation in green; zero without noise.
        noise_rms: root mean square of the same, which a few bright pixels dominate where light is scattered strongly forward.
        samples: paths per pixel; zero if none were traced.
    """

    path: Path
    truth: Truth
    cloud: Tensor
    sky: Tensor
    noise: float
    noise_rms: float
    samples: int

    def analysis(self) -> PhotographAnalysis:
        """Analysis of the file with mask, sky and sunlight as they truly are."""
        photograph = read_photograph(self.path, max_side=None)
        colour, sky = torch.tensor(self.truth.sunlight_colour), self.sky.mean((0, 1))
        sunlight = Sunlight(colour, 0.0, 0.5, sky / sky.max())
        return PhotographAnalysis(photograph, CloudMask(_labels(self.cloud), "user"), self.sky, sunlight, ())

    def automatic_analysis(self) -> PhotographAnalysis:
        """Analysis of the file as a fit does it."""
        return analyse_photograph(self.read())

    def read(self) -> Photograph:
        """The file."""
        return read_photograph(self.path, max_side=None)


def photograph_of_opacity(scene: Scene, camera: Camera, truth: Truth, path: Path) -> SyntheticPhotograph:
    """Photograph of a cloud that is equally bright everywhere, grey = 1 - T: at once, without noise, for timings and quick runs."""
    optical_length = compute_optical_length(scene.grid, *camera.rays())
    cloud = visible_share(optical_length).unflatten(0, (camera.height, camera.width))
    transmittance = torch.exp(-truth.optical_depth * optical_length / optical_length.max())
    return _write(path, truth, 1.0 - transmittance, transmittance, cloud)


def photograph_by_path_tracing(
    scene: Scene, camera: Camera, truth: Truth, path: Path, *, noise: float, most_samples: int, seed: int
) -> SyntheticPhotograph:
    """Photograph by the reference path tracer; one that the path already holds is kept if it is the same.

    Args:
        scene: volume and sun.
        camera: of the photograph.
        truth: parameters without intensity.
        path: of the PNG; its truth goes into a JSON file beside it.
        noise: median relative standard deviation of a cloud pixel to aim at.
        most_samples: paths per pixel that are not exceeded.
        seed: of the random streams.

    Returns:
        The photograph, with the noise that was reached.
    """
    optical_length = compute_optical_length(scene.grid, *camera.rays())
    cloud = visible_share(optical_length).unflatten(0, (camera.height, camera.width))
    question = {
        "grid": (scene.grid.density, scene.grid.lower, scene.grid.upper),
        "sun": scene.sun_direction,
        "camera": camera,
        "truth": asdict(replace(truth, sunlight_intensity=0.0)),
        "work": (noise, most_samples, seed, PILOT_SAMPLES, ORDERS),
    }
    key, sidecar = table_key(question), path.with_suffix(".json")
    if path.exists() and sidecar.exists():
        known = json.loads(sidecar.read_text())
        if known["key"] == key:
            exact = replace(truth, sunlight_intensity=known["sunlight_intensity"])
            sky = sky_gradient(camera.width, camera.height)
            return SyntheticPhotograph(path, exact, cloud, sky, known["noise"], known["noise_rms"], known["samples"])

    def trace(samples: int, stream: int) -> ReferenceImage:
        return trace_reference(
            scene.grid,
            camera,
            scene.sun_direction,
            extinction=truth.optical_depth / float(optical_length.max()),
            asymmetry=truth.asymmetry,
            albedo=truth.albedo,
            orders=ORDERS,
            samples=samples,
            seed=2 * seed + stream,
        )

    pilot = trace(PILOT_SAMPLES, 0)
    ratio = _noise(pilot, truth, cloud)[0] / noise
    samples = min(most_samples, max(LEAST_SAMPLES, round(PILOT_SAMPLES * ratio * ratio)))
    image = trace(samples, 1)
    photograph = _write(path, truth, image.radiance, image.transmittance, cloud)
    reached, rms = _noise(image, truth, cloud)
    photograph = replace(photograph, noise=reached, noise_rms=rms, samples=samples)
    kept = {"key": key, "noise": reached, "noise_rms": rms, "samples": samples, **asdict(photograph.truth)}
    sidecar.write_text(json.dumps(kept, indent=2) + "\n")
    return photograph


def photograph_by_stack(scene: Scene, truth: Truth, path: Path, effort: Effort, seed: int) -> SyntheticPhotograph:
    """Photograph with the scene's camera from a stack that has the true node alone: soon there, all orders, hardly any noise."""
    camera = scene.camera
    optical_length = compute_optical_length(scene.grid, *camera.rays())
    cloud = visible_share(optical_length).unflatten(0, (camera.height, camera.width))
    extinction = truth.optical_depth / float(optical_length.max())
    node = torch.tensor([truth.asymmetry]), torch.tensor([extinction])
    tables = build_scattering_stack(scene.grid, camera, scene.sun_direction, *node, effort, seed)
    with torch.no_grad():
        layers = ScatteringStack(tables)(*node, torch.tensor([truth.albedo]))
    grey = torch.zeros_like(optical_length)
    grey[tables.pixel] = (layers.single + layers.multiple)[0]
    return _write(path, truth, grey, torch.exp(-extinction * optical_length), cloud)


def _labels(cloud: Tensor) -> Tensor:
    return torch.where(cloud, int(Label.CLOUD), int(Label.SKY)).to(torch.uint8)


def _intensity(truth: Truth, grey: Tensor, cloud: Tensor) -> float:
    """Intensity of the sunlight with which the bright clouds reach their level."""
    bright = float(grey[cloud.flatten()].quantile(BRIGHT_SHARE))
    level = float(srgb_to_linear(torch.full((3,), truth.bright_level))[0])
    return (level - truth.ambient) / bright


def _noise(image: ReferenceImage, truth: Truth, cloud: Tensor) -> tuple[float, float]:
    """Median and root mean square of the relative standard deviation of the green channel of the cloud pixels."""
    sky = sky_gradient(cloud.shape[1], cloud.shape[0])[..., 1].flatten()
    intensity, colour = _intensity(truth, image.radiance, cloud), truth.sunlight_colour[1]
    value = colour * (intensity * image.radiance + truth.ambient * (1.0 - image.transmittance))
    slope = sky - colour * truth.ambient
    variance = (colour * intensity) ** 2 * image.radiance_variance + slope**2 * image.transmittance_variance
    share = torch.exp(torch.tensor(-truth.air_depth[1]))
    seen = share * (value + image.transmittance * sky) + (1.0 - share) * sky
    relative = (share * variance.sqrt() / seen)[cloud.flatten()]
    return float(relative.median()), float(relative.square().mean().sqrt())


def _write(path: Path, truth: Truth, grey: Tensor, transmittance: Tensor, cloud: Tensor) -> SyntheticPhotograph:
    """Compose the photograph, and write it with its mask."""
    height, width = cloud.shape
    sky = sky_gradient(width, height)
    exact = replace(truth, sunlight_intensity=_intensity(truth, grey, cloud))
    through = transmittance.unflatten(0, (height, width))[..., None]
    sunlit = exact.sunlight_intensity * grey.unflatten(0, (height, width))[..., None]
    in_front = torch.tensor(truth.sunlight_colour) * (sunlit + truth.ambient * (1.0 - through)) + through * sky
    air = torch.exp(-torch.tensor(truth.air_depth))
    path.parent.mkdir(parents=True, exist_ok=True)
    write_png(path, air * in_front + (1.0 - air) * sky)
    write_mask_png(path.with_name(f"{path.stem}_mask.png"), _labels(cloud))
    return SyntheticPhotograph(path, exact, cloud, sky, 0.0, 0.0, 0)
