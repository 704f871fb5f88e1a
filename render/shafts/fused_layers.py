"""The layers of the air in fused loops: optical depths, their exponentials and phase functions; imported only where numba is installed."""

import numpy as np
from numba import njit

from render.media import ExponentialDecay, LinearDecay, Uniform
from render.shafts.air import Air, Constituent
from render.shafts.fog_bank import FogBank
from render.shafts.fused_shadows import OPTIONS, Doubles

loop = njit(**OPTIONS)

KINDS = {Uniform: 0.0, LinearDecay: 1.0, ExponentialDecay: 2.0}
"""Numbers of the profiles."""

BANK = 3.0
"""Number of a bank of fog, whose depths are not those of a layer."""


@loop
def moment(x: float) -> float:
    """(1 - exp(-x)) / x for x of at least 0; the series is exact to 1e-11 where it is used."""
    if x < 0.06:
        return 1.0 - x * (0.5 - x * (1.0 / 6.0 - x * (1.0 / 24.0 - x * (1.0 / 120.0 - x * (1.0 / 720.0)))))
    return (1.0 - np.exp(-x)) / x


@loop
def mean_exponential(first: float, last: float) -> float:
    """As `exponential_mean`."""
    low = min(first, last)
    return 0.0 if low > 700.0 else np.exp(-low) * moment(abs(last - first))


@loop
def grey_depth(layers: Doubles, m: int, first: float, last: float, length: float) -> float:
    """Optical depth of a part of a ray between two heights through one layer."""
    kind, extinction, base, top = layers[m, 0], layers[m, 1], layers[m, 2], layers[m, 3]
    low, high = min(first, last), max(first, last)
    if high < base or low > top or extinction == 0.0:
        return 0.0
    inner_low, inner_high = max(low, base), min(high, top)
    part = length
    if low < base or high > top:
        part *= (inner_high - inner_low) / (high - low)
    if kind == 0.0:
        return extinction * part
    if kind == 1.0:
        return extinction * part * (top - 0.5 * (inner_low + inner_high)) / (top - base)
    reference, scale = layers[m, 4], layers[m, 5]
    return extinction * part * np.exp((reference - inner_low) / scale) * moment((inner_high - inner_low) / scale)


@loop
def grey_extinction(layers: Doubles, m: int, height: float) -> float:
    """Extinction of one layer at a height."""
    kind, extinction, base, top = layers[m, 0], layers[m, 1], layers[m, 2], layers[m, 3]
    if not base <= height <= top:
        return 0.0
    if kind == 0.0:
        return extinction
    if kind == 1.0:
        return extinction * (top - height) / (top - base)
    return extinction * np.exp((layers[m, 4] - height) / layers[m, 5])


@loop
def evaluate_phase(asymmetry: float, cosine: float) -> float:
    """Henyey-Greenstein, or Rayleigh where the asymmetry is no number."""
    if np.isnan(asymmetry):
        return 3.0 / (16.0 * np.pi) * (1.0 + cosine * cosine)
    size = abs(asymmetry)
    peak = (1.0 - size) ** 2 + 2.0 * max(size - asymmetry * cosine, 0.0)
    return (1.0 - asymmetry * asymmetry) / (4.0 * np.pi) / (peak * np.sqrt(peak))


def layer_array(air: Air) -> Doubles:
    """One row for all particles of a kind: kind, extinction, base, top, reference, scale, colour (3), albedo, asymmetry or NaN."""
    rows = np.zeros((len(air.particles), 11))
    for row, part in zip(rows, air.particles, strict=True):
        if isinstance(part, Constituent):
            medium = part.medium
            reference, scale = getattr(medium, "reference", 0.0), getattr(medium, "scale_height", 1.0)
            extinction = getattr(medium, "extinction", 0.0)
            row[:6] = KINDS[type(medium)], extinction, medium.base, medium.top, reference, scale
        elif isinstance(part, FogBank):
            # Its layer is empty: no height lies above the base and below the top.
            row[:4] = BANK, part.extinction, np.inf, -np.inf
        row[6:9], row[9] = part.colour, part.albedo
        row[10] = np.nan if part.phase == "rayleigh" else part.asymmetry
    return rows
