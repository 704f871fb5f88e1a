"""The searched rendering parameters and the map between them and the unit cube in which every optimiser works."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from render.errors import ParameterError

Scale = Literal["linear", "log"]
Ambient = Literal["sun", "sky", "free"]

LARGEST_OPTICAL_DEPTH_RANGE = (0.05, 200.0)
"""Optical depth of the densest view ray at the two ends of the default extinction range."""

SUNLIGHT_INTENSITY_RANGE = (0.1, 1000.0)
"""Wide enough that the brightest grey of a photograph is reachable with phase functions that integrate to 1."""

ASYMMETRY_RANGE = (0.0, 0.9)


@dataclass(frozen=True)
class Parameter:
    """One searched parameter: its name, the paper's letter, its unit and the closed interval that is searched.

    Args:
        name: public name, an identifier.
        symbol: letter of the paper.
        unit: unit of `lower` and `upper`; "1" for a pure number.
        lower: value at 0 in the unit cube [unit].
        upper: value at 1 in the unit cube [unit].
        scale: "linear", or "log" for equal ratios on equal steps (then `lower` > 0).

    Raises:
        ParameterError: when the interval is empty, not finite, or reaches 0 on a log scale.
    """

    name: str
    symbol: str
    unit: str
    lower: float
    upper: float
    scale: Scale = "linear"

    def __post_init__(self) -> None:
        if self.scale not in ("linear", "log"):
            raise ParameterError(f"{self.name}: expected the scale 'linear' or 'log', got {self.scale!r}")
        if not (math.isfinite(self.lower) and math.isfinite(self.upper) and self.lower < self.upper):
            raise ParameterError(
                f"{self.name}: expected a finite range with lower < upper [{self.unit}], got {self.lower}..{self.upper}"
            )
        if self.scale == "log" and self.lower <= 0:
            raise ParameterError(
                f"{self.name}: a log scale needs lower > 0, got {self.lower} [{self.unit}]; raise it or use 'linear'"
            )


@dataclass(frozen=True)
class SearchSpace:
    """The box that is searched: its parameters, in the order of the columns of every population.

    Raises:
        ParameterError: when there is no parameter or a name occurs twice.
    """

    parameters: tuple[Parameter, ...]

    def __post_init__(self) -> None:
        if not self.parameters:
            raise ParameterError("a search space needs at least one parameter, got none")
        if len(set(self.names)) != len(self.names):
            raise ParameterError(f"expected distinct parameter names, got {', '.join(self.names)}")

    @property
    def dimension(self) -> int:
        """Number of parameters."""
        return len(self.parameters)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in column order."""
        return tuple(parameter.name for parameter in self.parameters)

    def to_physical(self, unit_cube: Tensor) -> Tensor:
        """Values in units from points of the unit cube; differentiable.

        linear: lower + u (upper - lower);  log: lower (upper / lower)^u.

        Args:
            unit_cube: (population, parameter), in 0..1.

        Returns:
            (population, parameter), each column in its parameter's unit.

        Raises:
            ParameterError: when the shape is another.
        """
        self._require_shape(unit_cube, "unit_cube")
        lower, upper, is_log = self._bounds(unit_cube)
        blended = lower + unit_cube * (upper - lower)
        # The exponential of a linear column is not chosen, but overflow there would still spoil its gradient.
        exponential = torch.where(is_log, blended, torch.zeros_like(blended)).exp()
        physical = torch.where(is_log, exponential, blended)
        # Rounding must not step over an end of the range: beyond the last node of a table the gradient is another.
        ends = torch.tensor([(p.lower, p.upper) for p in self.parameters], dtype=torch.float64, device=physical.device)
        exact = torch.where(unit_cube == 0.0, ends[:, 0], torch.where(unit_cube == 1.0, ends[:, 1], physical))
        return (physical + (exact - physical).detach()).to(unit_cube.dtype)

    def to_unit(self, physical: Tensor) -> Tensor:
        """Points of the unit cube from values in units: the inverse of `to_physical`; differentiable.

        Args:
            physical: (population, parameter), each column in its parameter's unit.

        Returns:
            (population, parameter); outside 0..1 where a value is outside its range.

        Raises:
            ParameterError: when the shape is another, or a value on a log scale is not positive.
        """
        self._require_shape(physical, "physical")
        lower, upper, is_log = self._bounds(physical)
        if bool((is_log & (physical <= 0)).any()):
            names = [parameter.name for parameter in self.parameters if parameter.scale == "log"]
            raise ParameterError(f"expected positive values of {', '.join(names)} (log scale), got {physical.tolist()}")
        # The logarithm of a linear column may be NaN, and its gradient would be NaN too even though it is not chosen.
        logarithm = torch.where(is_log, physical, torch.ones_like(physical)).double().log()
        return ((torch.where(is_log, logarithm, physical.double()) - lower) / (upper - lower)).to(physical.dtype)

    def as_dict(self, physical_row: Tensor | Sequence[float]) -> dict[str, float]:
        """Names and values of one candidate.

        Args:
            physical_row: (parameter,), each value in its parameter's unit.

        Returns:
            {name: value [unit]} in column order.

        Raises:
            ParameterError: when the length is another.
        """
        row = torch.as_tensor(physical_row)
        if row.shape != (self.dimension,):
            raise ParameterError(f"expected a row of shape ({self.dimension},), got {tuple(row.shape)}")
        return dict(zip(self.names, row.tolist(), strict=True))

    def _bounds(self, like: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Ends of the ranges, logarithms of them on a log scale, and which columns are on one; (parameter,) each.

        In float64, so that 0 and 1 in the unit cube give the ends of a float32 range to the last bit.
        """
        rows = [
            (math.log(p.lower), math.log(p.upper)) if p.scale == "log" else (p.lower, p.upper) for p in self.parameters
        ]
        ends = torch.tensor(rows, dtype=torch.float64, device=like.device)
        is_log = torch.tensor([p.scale == "log" for p in self.parameters], device=like.device)
        return ends[:, 0], ends[:, 1], is_log

    def _require_shape(self, table: Tensor, name: str) -> None:
        if table.ndim != 2 or table.shape[1] != self.dimension:
            raise ParameterError(
                f"{name}: expected (population, parameter) = (any, {self.dimension}), got {tuple(table.shape)}"
            )
        if not table.is_floating_point():
            raise ParameterError(f"{name}: expected floating-point numbers, got {table.dtype}")


def cloud_search_space(
    largest_optical_length: float,
    ambient: Ambient = "sun",
    extinction_range: tuple[float, float] | None = None,
    asymmetry_range: tuple[float, float] = ASYMMETRY_RANGE,
    sunlight_intensity_range: tuple[float, float] = SUNLIGHT_INTENSITY_RANGE,
) -> SearchSpace:
    """The search space of the 2012 paper (section 3.2), with ranges free of the scale of the scene.

    `ambient` = L_amb / sigma_t, so that the ambient image is ambient (1 - exp(-sigma_t OD)) and 0..1 means the same in
    every volume. Albedo and asymmetry are linear as in the paper.

    Args:
        largest_optical_length: largest integral of density along any view ray [m].
        ambient: colour of the ambient light: that of the sun, that of the sky, or free (three more parameters).
        extinction_range: ends of the extinction range [1/m]; without it, those at which the densest view ray has
            the optical depths `LARGEST_OPTICAL_DEPTH_RANGE`.
        asymmetry_range: ends of the asymmetry range [1].
        sunlight_intensity_range: ends of the range of L_in, radiance relative to display white [1].

    Returns:
        sunlight_intensity, asymmetry, extinction, albedo, ambient, and with "free" ambient_red, _green, _blue.

    Raises:
        ParameterError: when the length is not a positive finite number or `ambient` is not one of the three.
    """
    if ambient not in ("sun", "sky", "free"):
        raise ParameterError(f"expected ambient light of the colour 'sun', 'sky' or 'free', got {ambient!r}")
    if extinction_range is None:
        if not (math.isfinite(largest_optical_length) and largest_optical_length > 0):
            raise ParameterError(
                f"expected a positive largest optical length [m], got {largest_optical_length}; is the volume in view?"
            )
        thin, thick = LARGEST_OPTICAL_DEPTH_RANGE
        extinction_range = (thin / largest_optical_length, thick / largest_optical_length)
    searched = (
        Parameter("sunlight_intensity", "L_in", "1", *sunlight_intensity_range, "log"),
        Parameter("asymmetry", "g", "1", *asymmetry_range),
        Parameter("extinction", "sigma_t", "1/m", *extinction_range, "log"),
        Parameter("albedo", "beta", "1", 0.0, 1.0),
        Parameter("ambient", "L_amb/sigma_t", "1", 0.0, 1.0),
    )
    colour = tuple(Parameter(f"ambient_{c}", f"c_amb,{c[0]}", "1", 0.0, 1.0) for c in ("red", "green", "blue"))
    return SearchSpace(searched + colour if ambient == "free" else searched)
