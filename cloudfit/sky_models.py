"""The two models of the clear sky behind one face: accurate integrals, and the tables of the reference."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import torch
from torch import Tensor

from precompute.atmosphere.sky_view import build_sky_view
from precompute.atmosphere.source_store import load_or_build_source
from precompute.atmosphere_store import prepare_atmosphere_tables
from precompute.atmosphere_tables import TablePlan
from render.atmosphere.parameters import AtmosphereParameters, spectrum_tensor
from render.atmosphere.sky import AirLight, look_up_radiance_to_point, look_up_surface_irradiance
from render.atmosphere.sky_image import compose_sky, compose_sky_view
from render.atmosphere.sky_view import look_up_sky_view
from render.atmosphere.source_function import SourceFunction
from render.atmosphere.surface_light import compute_surface_irradiance
from render.atmosphere.tables import AtmosphereTables, TableSizes
from render.errors import ParameterError

Progress = Callable[[str, float], None]

WAVELENGTHS = tuple(1e-9 * value for value in range(400, 701, 50))
"""Seven are needed for the colours of dusk: three miss most of what ozone absorbs, and make it purple [m]."""

TOLERANCES = {"draft": 0.05, "standard": 0.01, "reference": 0.004}
"""Accepted error of the light scattered more than once, by quality [1]."""

PLANS = {
    "draft": TablePlan(sizes=TableSizes(32, 128, 8, 32, 16, 64, 8, 24), orders=3),
    "standard": TablePlan(),
    "reference": TablePlan(orders=8),
}
"""Tables in the manner of the reference, by quality."""


class SkyModel(Protocol):
    """What pictures ask of a sky; z points to the zenith of the camera, `sun` is a unit vector `(3,)`, altitudes are in metres."""

    @property
    def atmosphere(self) -> AtmosphereParameters:
        """The planet."""

    def compose(self, altitude: float, direction: Tensor, sun: Tensor) -> Tensor:
        """Radiance of air, ground and sun in directions `(ray, 3)`: `(ray, wavelength)` [W/m^2/sr/nm]."""

    def light_up_to(self, distance: float, altitude: float, direction: Tensor, sun: Tensor) -> AirLight:
        """What the air up to a distance [m] adds in directions `(ray, 3)`, and what it lets through."""

    def light_at(self, altitude: float, sun: Tensor) -> tuple[Tensor, Tensor]:
        """The sun's irradiance of a surface that faces it [W/m^2/nm], and the mean radiance of all around, sky and ground, that light
        on a level surface from above and from below makes out [W/m^2/sr/nm], each `(wavelength,)`."""


@dataclass(frozen=True, eq=False)
class AccurateSky:
    """Integrals along rays, tabulated for each camera and sun.

    Args:
        source: of the planet.
    """

    source: SourceFunction

    @property
    def atmosphere(self) -> AtmosphereParameters:
        """The planet."""
        return self.source.atmosphere

    def compose(self, altitude: float, direction: Tensor, sun: Tensor) -> Tensor:
        """As `SkyModel.compose`."""
        return compose_sky_view(build_sky_view(self.source, altitude, sun), direction)

    def light_up_to(self, distance: float, altitude: float, direction: Tensor, sun: Tensor) -> AirLight:
        """As `SkyModel.light_up_to`."""
        return look_up_sky_view(build_sky_view(self.source, altitude, sun, reach=distance), direction.double())[0]

    def light_at(self, altitude: float, sun: Tensor) -> tuple[Tensor, Tensor]:
        """As `SkyModel.light_at`."""
        normals = torch.stack([sun, sun.new_tensor([0.0, 0.0, 1.0]), sun.new_tensor([0.0, 0.0, -1.0])])
        found = compute_surface_irradiance(build_sky_view(self.source, altitude, sun), normals)
        return found.sun[0], (found.sky + found.ground)[1:].sum(0) / (2.0 * math.pi)


@dataclass(frozen=True, eq=False)
class TabulatedSky:
    """Look-ups in tables that are filled as the reference fills them.

    Args:
        tables: of the planet.
    """

    tables: AtmosphereTables

    @property
    def atmosphere(self) -> AtmosphereParameters:
        """The planet."""
        return self.tables.atmosphere

    def compose(self, altitude: float, direction: Tensor, sun: Tensor) -> Tensor:
        """As `SkyModel.compose`."""
        return compose_sky(self.tables, altitude, direction, sun)

    def light_up_to(self, distance: float, altitude: float, direction: Tensor, sun: Tensor) -> AirLight:
        """As `SkyModel.light_up_to`."""
        eye = self._eye(altitude, direction)
        return look_up_radiance_to_point(self.tables, eye, eye + distance * direction.double(), sun)

    def light_at(self, altitude: float, sun: Tensor) -> tuple[Tensor, Tensor]:
        """As `SkyModel.light_at`; from below comes what the ground reflects, as if there were no air between."""
        eye, ground = self._eye(altitude, sun), self._eye(0.0, sun)
        zenith = eye / torch.linalg.vector_norm(eye)
        facing = look_up_surface_irradiance(self.tables, eye, sun, sun).sun
        above = look_up_surface_irradiance(self.tables, eye, zenith, sun).sky
        lit = look_up_surface_irradiance(self.tables, ground, zenith, sun)
        below = spectrum_tensor(self.atmosphere.ground_albedo, above) * (lit.sun + lit.sky)
        return facing, (above + below) / (2.0 * math.pi)

    def _eye(self, altitude: float, like: Tensor) -> Tensor:
        return torch.tensor(
            [0.0, 0.0, self.atmosphere.bottom_radius + altitude], dtype=torch.float64, device=like.device
        )


@dataclass(frozen=True)
class PreparedSky:
    """Where a model came from.

    Args:
        seconds: it took to build or to load.
        reused: whether it was loaded.
        path: of its file, or None if it was not kept.
    """

    seconds: float
    reused: bool
    path: Path | None


def prepare_sky(
    mode: str,
    atmosphere: AtmosphereParameters,
    quality: str,
    folder: Path | None,
    on_progress: Progress = lambda stage, share: None,
) -> tuple[SkyModel, PreparedSky]:
    """Build a model of the sky, or load it.

    Args:
        mode: one of `SKY_MODES`.
        atmosphere: the planet.
        quality: one of `TOLERANCES`.
        folder: of the tables; None keeps nothing.
        on_progress: is told what is being done.

    Returns:
        The model, and where it came from.

    Raises:
        ParameterError: for a mode or a quality that there is not.
        StoreError: if tables cannot be written.
    """
    if mode not in SKY_MODES or quality not in TOLERANCES:
        raise ParameterError(
            f"expected a mode of {', '.join(SKY_MODES)} and a quality of {', '.join(TOLERANCES)}, not {mode} and {quality}"
        )
    started = time.perf_counter()
    model, reused, path = SKY_MODES[mode](atmosphere, quality, folder, on_progress)
    return model, PreparedSky(time.perf_counter() - started, reused, path)


def _prepare_accurate(
    atmosphere: AtmosphereParameters, quality: str, folder: Path | None, on_progress: Progress
) -> tuple[SkyModel, bool, Path | None]:
    source, stored = load_or_build_source(folder, atmosphere, tolerance=TOLERANCES[quality], on_progress=on_progress)
    return AccurateSky(source), stored.reused, stored.path


def _prepare_tabulated(
    atmosphere: AtmosphereParameters, quality: str, folder: Path | None, on_progress: Progress
) -> tuple[SkyModel, bool, Path | None]:
    tables, report = prepare_atmosphere_tables(atmosphere, PLANS[quality], folder, on_progress)
    return TabulatedSky(tables), report.reused, report.path


SKY_MODES: dict[str, Callable[..., tuple[SkyModel, bool, Path | None]]] = {
    "accurate": _prepare_accurate,
    "parity": _prepare_tabulated,
}
"""How each mode is prepared."""
