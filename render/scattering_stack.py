"""The scattering stack: precomputed images of a cloud, and their composition for any candidate.

For a fixed volume, camera and sun the radiance of a cloud pixel is (Dobashi et al. 2012, equations 5, 8 and 9)

    grey(q) = L_in [ beta p(theta, g) S1(q, s) + sum_k beta^k f_k(q, g, s) ] + ambient (1 - T(q, s))
    T(q, s) = exp(-s u(q))

with the sunlight's intensity L_in, the albedo beta, the asymmetry g, the extinction s [1/m], the phase function p, the cosine of the angle
theta between view and sun, the optical length u [m], the single-scattering integral S1 and the orders f_k, k >= 2. S1 and f_k are
tables, interpolated over ln s and g. Powers of s are straight lines in logarithms, so those of S1, which has no noise, are interpolated.
f_k is split into its mean over the pixels, whose logarithm is interpolated, and the image relative to that mean, which is interpolated as
it is: the logarithm of a noisy number is too small on average, between nodes by half its relative variance.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from render.errors import ParameterError
from render.interpolation import cubic_weights
from render.phase_functions import evaluate_phase_function

SMALLEST_SHARE = 1e-7
"""Table entries are held at this share of their node's largest entry, so that their logarithm exists."""

SMALLEST_MEAN = 1e-37
"""Mean of an order's image below which it counts as black; float32 holds little less."""


@dataclass(frozen=True, eq=False)
class ScatteringTables:
    """Precomputed images of the cloud pixels, for unit sunlight and albedo one.

    Args:
        width, height: pixel counts of the image.
        pixel: numbers of the pixels that see cloud `(pixel,)`; all others hold sky only.
        optical_length: of the view ray through each of them `(pixel,)` [m].
        cos_sun: cosine of the angle between view and sun `(pixel,)`.
        asymmetry: nodes `(asymmetry,)`.
        extinction: nodes `(extinction,)` [1/m].
        single: S1 `(extinction, pixel)`.
        multiple: f_k `(order, asymmetry, extinction, pixel)` [1/sr], entry 0 is k = 2.
        standard_error: relative RMS over the pixels of each order's image `(order, asymmetry, extinction)`.
        image_error: the same for the sum of all orders at albedo one `(asymmetry, extinction)`.
        effective_share: effective sample size over paths `(order, asymmetry, extinction)`.
    """

    width: int
    height: int
    pixel: Tensor
    optical_length: Tensor
    cos_sun: Tensor
    asymmetry: Tensor
    extinction: Tensor
    single: Tensor
    multiple: Tensor
    standard_error: Tensor
    image_error: Tensor
    effective_share: Tensor

    @property
    def largest_optical_length(self) -> float:
        """Largest optical length of any view ray [m]; zero for an empty image."""
        return float(self.optical_length.max()) if len(self.optical_length) else 0.0


@dataclass(frozen=True, eq=False)
class CloudLayers:
    """Grey layers of the cloud pixels of a population, unit sunlight and unit ambient light.

    Args:
        single: beta p S1 `(population, pixel)`.
        multiple: sum of beta^k f_k `(population, pixel)`.
        transmittance: T `(population, pixel)`.
        opacity: 1 - T `(population, pixel)`, the ambient layer, exact for thin clouds.
    """

    single: Tensor
    multiple: Tensor
    transmittance: Tensor
    opacity: Tensor


class ScatteringStack(nn.Module):
    """Composes the images of a population from the tables; differentiable in every parameter.

    Args:
        tables: the precomputed images.
        largest_image_error: nodes with a larger `image_error` are marked as unusable.
    """

    pixel: Tensor
    optical_length: Tensor
    cos_sun: Tensor
    log_single: Tensor
    log_mean: Tensor
    relative: Tensor
    usable: Tensor

    def __init__(self, tables: ScatteringTables, largest_image_error: float = torch.inf) -> None:
        super().__init__()
        self.tables = tables
        self.register_buffer("pixel", tables.pixel)
        self.register_buffer("optical_length", tables.optical_length)
        self.register_buffer("cos_sun", tables.cos_sun)
        self.register_buffer("log_single", _safe_log(tables.single))
        mean = tables.multiple.double().sum(-1) / max(len(tables.pixel), 1)
        mean = mean.clamp(min=SMALLEST_MEAN).to(tables.multiple.dtype)
        self.register_buffer("log_mean", mean.log().flatten(1))
        self.register_buffer("relative", (tables.multiple / mean[..., None]).flatten(1, 2))
        self.register_buffer("usable", tables.image_error <= largest_image_error)

    @property
    def orders(self) -> int:
        """Largest number of scatterings in the tables."""
        return len(self.relative) + 1

    def forward(self, asymmetry: Tensor, extinction: Tensor, albedo: Tensor) -> CloudLayers:
        """Grey layers of a population.

        Args:
            asymmetry: `(population,)`.
            extinction: `(population,)` [1/m]. Below the nodes order k falls with the k-th power, its thin limit; above, the
                tables are held; the transmittance is exact everywhere.
            albedo: `(population,)` in 0..1.

        Returns:
            The layers, each `(population, pixel)`.

        Raises:
            ParameterError: if the shapes differ.
        """
        if not (asymmetry.shape == extinction.shape == albedo.shape and asymmetry.ndim == 1):
            raise ParameterError(
                "asymmetry, extinction and albedo need one shape (population,), not "
                f"{tuple(asymmetry.shape)}, {tuple(extinction.shape)} and {tuple(albedo.shape)}"
            )
        nodes = self.tables.extinction.to(extinction)
        # Not clamp: at the first node its gradient would add to that of the clamp below.
        thinner = torch.where(extinction < nodes[0], extinction / nodes[0], 1.0)[:, None]
        of_extinction = cubic_weights(nodes.log(), extinction.clamp(min=float(nodes[0])).log())
        of_asymmetry = cubic_weights(self.tables.asymmetry, asymmetry)
        node_weights = (of_asymmetry[:, :, None] * of_extinction[:, None, :]).flatten(1)
        phase = evaluate_phase_function(self.cos_sun.to(asymmetry), asymmetry[:, None])
        single = albedo[:, None] * thinner * phase * (of_extinction @ self.log_single.to(albedo)).exp()
        multiple = torch.zeros_like(single)
        for number, (log_mean, relative) in enumerate(zip(self.log_mean, self.relative, strict=True)):
            power = (albedo[:, None] * thinner) ** (number + 2) * (node_weights @ log_mean.to(albedo)).exp()[:, None]
            # Cubic weights may be negative: next to a black pixel the interpolated image can fall a little below zero.
            multiple = multiple + power * (node_weights @ relative.to(albedo)).clamp(min=0.0)
        depth = extinction[:, None] * self.optical_length.to(albedo)
        return CloudLayers(single, multiple, torch.exp(-depth), -torch.expm1(-depth))

    def is_usable(self, asymmetry: Tensor, extinction: Tensor) -> Tensor:
        """Whether all nodes around each candidate meet the accepted error `(population,)` bool."""
        columns = _surrounding(self.tables.extinction, extinction)
        rows = _surrounding(self.tables.asymmetry, asymmetry)
        return torch.stack([self.usable[row, column] for row in rows for column in columns]).all(0)


def _surrounding(nodes: Tensor, values: Tensor) -> tuple[Tensor, Tensor]:
    """Numbers of the nodes below and above values."""
    upper = torch.searchsorted(nodes, values.to(nodes).contiguous()).clamp(max=len(nodes) - 1)
    return (upper - 1).clamp(min=0), upper


def _safe_log(table: Tensor) -> Tensor:
    """Logarithm of a table whose last axis is the pixel, held at a small share of each image's maximum."""
    if table.shape[-1] == 0:
        return table
    floor = (table.amax(-1, keepdim=True) * SMALLEST_SHARE).clamp(min=1e-37)
    return table.maximum(floor).log()
