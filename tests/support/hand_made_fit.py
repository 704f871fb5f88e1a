"""A small fit made by hand, so that tests of results, pages and batches need neither search nor light transport."""

import math
from pathlib import Path

import torch

from cloudfit.analysis import NoCloudError, PhotographAnalysis
from cloudfit.cloud_mask import CloudMask, Label
from cloudfit.determination import Determination, ParameterSpread
from cloudfit.fit_types import Candidate, FitOptions, PhotographFit, Picture
from cloudfit.parameters import SearchSpace, cloud_search_space
from cloudfit.photograph import Photograph
from cloudfit.result import Question
from cloudfit.result_document import Circumstances
from cloudfit.scene import Scene
from cloudfit.sunlight import Sunlight
from render.camera import frame_volume
from render.density_grid import DensityGrid
from render.image_files import write_png

HEIGHT, WIDTH = 6, 8
SECONDS = {"reading": 0.1, "search": 1.0, "pictures": 2.0, "total": 3.1}


def small_scene(sun_elevation_deg: float = 40.0) -> Scene:
    """A box of even density before a pinhole camera."""
    grid = DensityGrid.from_voxel_size(torch.full((4, 4, 4), 0.5), 10.0)
    camera = frame_volume(grid, width=WIDTH, height=HEIGHT)
    return Scene(grid, None, camera, math.radians(220.0), math.radians(sun_elevation_deg))


def write_photograph(path: Path, blue: float = 0.8) -> Path:
    """A photograph file: sky of some blue with a white block in it."""
    pixels = torch.tensor([0.2, 0.4, blue]).expand(HEIGHT, WIDTH, 3).clone()
    pixels[2:5, 2:6] = torch.linspace(0.4, 0.9, 4)[None, :, None]
    write_png(path, pixels)
    return path


def make_analysis(photograph: Photograph) -> PhotographAnalysis:
    """The white block is the cloud; the top row is sky, the bottom row ground."""
    labels = torch.full(photograph.pixels.shape[:2], Label.SKY, dtype=torch.uint8)
    labels[2:5, 2:6] = Label.CLOUD
    labels[-1] = Label.OTHER
    colour = torch.tensor([1.0, 0.9, 0.8])
    sunlight = Sunlight(colour, 0.5, 0.4, torch.tensor([0.3, 0.6, 1.0]))
    return PhotographAnalysis(photograph, CloudMask(labels), photograph.pixels.clone(), sunlight, ())


def make_picture(shade: float, width: int = WIDTH, height: int = HEIGHT) -> Picture:
    """Four layers that sum to the image."""
    ramp = torch.linspace(0.0, shade, height)[:, None, None].expand(height, width, 3)
    sky = torch.full((height, width, 3), 0.1)
    return Picture(
        rgb=ramp * 1.75 + sky,
        single=ramp,
        multiple=0.5 * ramp,
        ambient=0.25 * ramp,
        sky=sky,
        transmittance=torch.full((height, width), 0.5),
        image_error=0.02,
        seconds=0.5,
    )


def make_space(ambient: str = "sun") -> SearchSpace:
    """Ranges for a largest optical length of 20 m."""
    return cloud_search_space(20.0, ambient)  # type: ignore[arg-type]


def make_candidate(loss: float, asymmetry: float = 0.45) -> Candidate:
    """An answer with the albedo on its upper bound."""
    histogram = torch.zeros(3, 256, dtype=torch.float64)
    histogram[:, 100:104] = 0.25
    parameters = {
        "sunlight_intensity": 10.0,
        "asymmetry": asymmetry,
        "extinction": 0.2,
        "albedo": 1.0,
        "ambient": 0.5,
    }
    return Candidate(parameters, (0.0, 0.3, 0.6), loss - 0.01, loss, 12.5, 0.3, make_picture(loss), histogram)


def make_fit(
    analysis: PhotographAnalysis, interrupted: bool = False, losses: tuple[float, ...] = (0.6, 0.7)
) -> PhotographFit:
    """Two answers, unless told otherwise."""
    histogram = torch.zeros(3, 256, dtype=torch.float64)
    histogram[:, 98:102] = 0.25
    return PhotographFit(
        analysis=analysis,
        candidates=tuple(make_candidate(loss, 0.1 + 0.3 * number) for number, loss in enumerate(losses)),
        histogram=histogram,
        history=(0.9, 0.7, 0.6),
        evaluations=60,
        iterations=3,
        stop_reason="The budget of evaluations was spent.",
        interrupted=interrupted,
        seconds={"search": 1.0, "pictures": 2.0},
        warnings=("a warning <with> signs & all",),
        determination=None if interrupted else make_determination(),
    )


def make_determination() -> Determination:
    """The extinction is determined, the asymmetry is open."""
    narrow = {
        "sunlight_intensity": (9.0, 11.0),
        "extinction": (0.19, 0.21),
        "albedo": (0.9, 1.0),
        "ambient": (0.4, 0.5),
    }
    parameters = tuple(
        ParameterSpread(name, *narrow.get(name, (0.1, 0.7)), share=0.1 if name in narrow else 0.66)
        for name in make_space().names
    )
    return Determination(parameters, 42, 0.06)


def make_question(photograph_sha256: str | None = "00", **changes: object) -> Question:
    """A question about the small scene."""
    scene = changes.pop("scene", None) or small_scene()
    return Question(photograph_sha256, None, scene, FitOptions(**changes))  # type: ignore[arg-type]


def make_circumstances(photograph: Path) -> Circumstances:
    """Circumstances of a photograph without a mask."""
    return Circumstances(photograph, None, make_question(), SECONDS)


def refuse_clouds(photograph: Photograph, labels: object) -> PhotographAnalysis:
    """Stands in for an analysis that finds no cloud."""
    raise NoCloudError(f"{photograph.path}: expected clouds, found none")
