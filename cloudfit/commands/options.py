"""Options that several commands share, and what they mean in metres and radians."""

import enum
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from render.units import radians_from_degrees

if TYPE_CHECKING:
    from cloudfit.fit_types import FitOptions
    from cloudfit.quality import Quality as Preset
    from cloudfit.scene import Scene


class CameraType(enum.StrEnum):
    """Projections."""

    PINHOLE = "pinhole"
    ORTHOGRAPHIC = "orthographic"


class QualityName(enum.StrEnum):
    """Presets of effort; the same names as in `cloudfit.quality.QUALITIES`."""

    DRAFT = "draft"
    STANDARD = "standard"
    REFERENCE = "reference"


class TransferName(enum.StrEnum):
    """Display curves; the same names as in `render.colour.DISPLAY_CURVES`."""

    SRGB = "srgb"
    NONE = "none"


class AmbientName(enum.StrEnum):
    """Colours of the ambient light."""

    SUN = "sun"
    SKY = "sky"
    FREE = "free"


DEFAULT_WIDTH, DEFAULT_HEIGHT = 640, 480
DEFAULT_SUN_AZIMUTH, DEFAULT_SUN_ELEVATION = 220.0, 40.0
DEFAULT_CAMERA_ELEVATION, DEFAULT_FIELD_OF_VIEW = 10.0, 40.0

# As in `cloudfit.fit_types`, which is slow to import; a test compares them.
DEFAULT_OPTIMISER, DEFAULT_AIR_REFINEMENTS, DEFAULT_LOSS, DEFAULT_SEARCH_PIXELS = "screened_evolution", 2, "l1", 4000
DEFAULT_OPTICAL_DEPTHS = (0.05, 200.0)

SCENE, CAMERA, SEARCH, RUN = "Scene", "Camera", "Search", "Run"

Volume = Annotated[
    Path | None,
    typer.Option(
        help="Density volume (.npz, .npy, .vol, .vdb). Without it a procedural cumulus.", rich_help_panel=SCENE
    ),
]
SunAzimuth = Annotated[
    float, typer.Option(help="Where the sun stands, in degrees clockwise from north.", rich_help_panel=SCENE)
]
SunElevation = Annotated[
    float,
    typer.Option(min=-90, max=90, help="Height of the sun above the horizon, in degrees.", rich_help_panel=SCENE),
]
CameraAzimuth = Annotated[
    float, typer.Option(help="Direction of view, in degrees clockwise from north.", rich_help_panel=CAMERA)
]
CameraElevation = Annotated[
    float,
    typer.Option(min=-90, max=90, help="How far the camera looks upwards, in degrees.", rich_help_panel=CAMERA),
]
CameraFov = Annotated[
    float, typer.Option(min=0.1, max=179, help="Vertical opening angle, in degrees.", rich_help_panel=CAMERA)
]
CameraDistance = Annotated[
    float | None,
    typer.Option(
        min=0, help="From the middle of the cloud, in metres. Without it the cloud just fits.", rich_help_panel=CAMERA
    ),
]
CameraWidth = Annotated[int, typer.Option(min=1, help="Pixels in a row of the pictures.", rich_help_panel=CAMERA)]
CameraHeight = Annotated[int, typer.Option(min=1, help="Rows of the pictures.", rich_help_panel=CAMERA)]
CameraKind = Annotated[CameraType, typer.Option(help="Projection.", rich_help_panel=CAMERA)]
Quality = Annotated[QualityName, typer.Option(help="Trades time for accuracy.", rich_help_panel=SEARCH)]
Tolerance = Annotated[
    float | None,
    typer.Option(
        min=0.001,
        max=1,
        help="Accepted relative error of the precomputed cloud images, such as 0.05, instead of a preset of --quality.",
        rich_help_panel=SEARCH,
    ),
]
OpticalDepths = Annotated[
    tuple[float, float],
    typer.Option(
        help="Optical depth of the densest view ray in the thinnest and the thickest cloud that is searched. The tables cover just these: "
        "those of 0.01 0.1 take a second, for a haze of ice.",
        metavar="THIN THICK",
        rich_help_panel=SEARCH,
    ),
]
Seed = Annotated[
    int, typer.Option(min=0, help="Of every random stream; equal seeds give equal results.", rich_help_panel=RUN)
]
Tables = Annotated[
    Path | None,
    typer.Option(help="Folder of the precomputed tables. Without it .tables inside --out.", rich_help_panel=RUN),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Nothing on stderr but errors.", rich_help_panel=RUN)]
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", help="Tracebacks of unexpected errors on stderr.", rich_help_panel=RUN)
]
AsJson = Annotated[
    bool, typer.Option("--json", help="One JSON document on stdout instead of a table.", rich_help_panel=RUN)
]


@dataclass(frozen=True)
class SceneChoice:
    """A scene as the user states it: degrees and metres.

    Args:
        volume: file, or None for the procedural cumulus.
        sun_azimuth, sun_elevation: [degrees].
        camera_azimuth, camera_elevation, camera_fov: [degrees].
        camera_distance: [m], or None to take the cloud in.
        camera_width, camera_height: [pixel].
        camera_type: projection.
    """

    volume: Path | None = None
    sun_azimuth: float = DEFAULT_SUN_AZIMUTH
    sun_elevation: float = DEFAULT_SUN_ELEVATION
    camera_azimuth: float = 0.0
    camera_elevation: float = DEFAULT_CAMERA_ELEVATION
    camera_fov: float = DEFAULT_FIELD_OF_VIEW
    camera_distance: float | None = None
    camera_width: int = DEFAULT_WIDTH
    camera_height: int = DEFAULT_HEIGHT
    camera_type: CameraType = CameraType.PINHOLE

    def load(self) -> "Scene":
        """The scene. Raises VolumeError or CameraError where it cannot be."""
        from cloudfit.scene import Scene
        from cloudfit.scene_record import load_volume
        from render.camera import frame_volume

        grid = load_volume(self.volume)
        camera = frame_volume(
            grid,
            width=self.camera_width,
            height=self.camera_height,
            azimuth=radians_from_degrees(self.camera_azimuth),
            elevation=radians_from_degrees(self.camera_elevation),
            field_of_view=radians_from_degrees(self.camera_fov),
            distance=self.camera_distance,
            orthographic=self.camera_type is CameraType.ORTHOGRAPHIC,
        )
        return Scene(
            grid, self.volume, camera, radians_from_degrees(self.sun_azimuth), radians_from_degrees(self.sun_elevation)
        )

    def describe(self) -> str:
        """The volume in words."""
        return "the procedural cumulus (give yours with --volume)" if self.volume is None else str(self.volume)


@dataclass(frozen=True)
class SearchChoice:
    """The search as the user states it."""

    quality: QualityName = QualityName.STANDARD
    ambient: AmbientName = AmbientName.SUN
    transfer: TransferName = TransferName.SRGB
    optimiser: str = DEFAULT_OPTIMISER
    evaluations: int | None = None
    max_seconds: float | None = None
    candidates: int = 3
    seed: int = 0
    searches: int = 3
    air_refinements: int = DEFAULT_AIR_REFINEMENTS
    tolerance: float | None = None
    loss: str = DEFAULT_LOSS
    coarse_air: bool = False
    search_pixels: int = DEFAULT_SEARCH_PIXELS
    optical_depths: tuple[float, float] = DEFAULT_OPTICAL_DEPTHS

    def options(self) -> "FitOptions":
        """The options of a fit. Raises ParameterError for an optimiser or a loss that there is not."""
        from cloudfit.fit_types import FitOptions
        from cloudfit.losses import find_loss
        from cloudfit.optimisers import OPTIMISERS
        from render.errors import ParameterError

        if self.optimiser not in OPTIMISERS:
            raise ParameterError(f"no optimiser is called {self.optimiser!r}; there are {', '.join(OPTIMISERS)}")
        return FitOptions(
            quality=choose_quality(self.quality, self.tolerance),
            ambient=self.ambient.value,
            transfer=self.transfer.value,
            optimiser=self.optimiser,
            evaluations=self.evaluations,
            seconds=self.max_seconds,
            candidates=self.candidates,
            searches=self.searches,
            seed=self.seed,
            air_refinements=self.air_refinements,
            loss=find_loss(self.loss).name,
            coarse_air=self.coarse_air,
            search_pixels=self.search_pixels or None,
            optical_depths=self.optical_depths,
        )


def choose_quality(name: QualityName, tolerance: float | None) -> "Preset":
    """The preset, or one for the tolerance if there is any."""
    from cloudfit.quality import QUALITIES, quality_for

    return QUALITIES[name.value] if tolerance is None else quality_for(tolerance)
