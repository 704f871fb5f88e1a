"""The scattering stack: precomputed images of a cloud, and their composition for any candidate.

For a fixed volume, camera and sun the radiance of a cloud pixel is (Dobashi et al. 2012, equations 5, 8 and 9)

    grey(q) = L_in [ beta p(theta, g) S1(q, s) + sum_k beta^k f_k(q, g, s) ] + ambient (1 - T(q, s))
    T(q, s) = exp(-s u(q))

with the sunlight's intensity L_in, the albedo beta, the asymmetry g, the extinction s [1/m], the phase function p, the cosine of the angle
theta between view and sun, the optical length u [m], the single-scattering integral S1 and the orders f_k, k >= 2. S1 and f_k are
tables, interpolated over g and w = ln(1 + s / s_0) (`depth_nodes`), after division by the power of s that they are in thin clouds. Of S1,
which has no noise, logarithms are interpolated.
High orders share the images of a few knots: sum beta^k f_k over k >= 2 is taken as sum beta^K F_K over the knots K (how orders are shared
out is the builder's choice), and the orders beyond the last knot as a series k^(-3/2) r^k with a measured ratio r. F_K is split into its
mean over the pixels, whose logarithm is interpolated, and the image relative to that mean, which is interpolated as it is: the logarithm
of a noisy number is too small on average, between nodes by half its relative variance.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from render.depth_nodes import depth_coordinate
from render.errors import ParameterError
from render.faint_images import follow_thicker
from render.interpolation import cubic_weights, interpolate_limited, interpolate_limited_each, limited_slopes
from render.phase_functions import evaluate_phase_function

SMALLEST_SHARE = 1e-7
"""Table entries are held at this share of their node's largest entry, so that their logarithm exists."""

SMALLEST_PART = 1e-5
"""Of the multiple scattering below which an image is left out of a composition without gradients."""

BRIGHT_ALBEDO = 0.98
"""From which on an error goes over to that at albedo one."""

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
        soft_extinction: s_0 of the coordinate that images are interpolated over [1/m], a scalar.
        knots: exponents of the albedo `(knot,)`; 2, 3 and 4 stand for themselves, the others for the orders around them too.
        single: S1 `(extinction, pixel)`.
        multiple: f `(knot, asymmetry, extinction, pixel)` [1/sr].
        tail_ratio: r of the orders beyond the last knot K, which fall like k^(-3/2) r^k `(asymmetry, extinction)`; zero leaves them out.
        tail_share: of order K in the last image `(asymmetry, extinction)`.
        standard_error: relative RMS over the pixels of each image `(knot, asymmetry, extinction)`.
        image_error: the same for the composed image `(asymmetry, extinction)`.
        bright_error: the same at albedo one, where the orders beyond the last knot count most `(asymmetry, extinction)`.
        effective_share: effective sample size over paths `(knot, asymmetry, extinction)`.
        groups: what the builder did for each group of extinctions, in words and numbers that JSON can hold.
    """

    width: int
    height: int
    pixel: Tensor
    optical_length: Tensor
    cos_sun: Tensor
    asymmetry: Tensor
    extinction: Tensor
    soft_extinction: Tensor
    knots: Tensor
    single: Tensor
    multiple: Tensor
    tail_ratio: Tensor
    tail_share: Tensor
    standard_error: Tensor
    image_error: Tensor
    bright_error: Tensor
    effective_share: Tensor
    groups: tuple[dict[str, object], ...] = ()

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
        largest_image_error: nodes with a larger error are marked as unusable.
    """

    pixel: Tensor
    optical_length: Tensor
    cos_sun: Tensor
    log_single: Tensor
    log_mean: Tensor
    log_mean_slopes: Tensor
    relative: Tensor
    usable: Tensor

    def __init__(self, tables: ScatteringTables, largest_image_error: float = torch.inf) -> None:
        super().__init__()
        self.tables = tables
        self.register_buffer("pixel", tables.pixel)
        self.register_buffer("optical_length", tables.optical_length)
        self.register_buffer("cos_sun", tables.cos_sun)
        log_nodes = tables.extinction.double().log()
        self.register_buffer("log_single", _safe_log(tables.single) - log_nodes.to(tables.single)[:, None])
        mean = tables.multiple.sum(-1).double() / max(len(tables.pixel), 1)
        black = mean <= SMALLEST_MEAN
        mean = mean.clamp(min=SMALLEST_MEAN).to(tables.multiple.dtype)
        log_mean = (mean.double().log() - _thin_powers(tables.knots)[:, None, None] * log_nodes).to(mean)
        relative = tables.multiple / mean[..., None]
        nodes = depth_coordinate(tables.extinction, tables.soft_extinction)
        follow_thicker(black, nodes, log_mean, relative)
        self.register_buffer("log_mean", log_mean.flatten(0, 1))
        self.register_buffer("log_mean_slopes", limited_slopes(nodes, log_mean).flatten(0, 1))
        self.register_buffer("relative", relative.flatten(1, 2))
        self.register_buffer("usable", tables.image_error <= largest_image_error)
        self.largest_image_error = largest_image_error

    @property
    def orders(self) -> int:
        """Largest number of scatterings that was traced."""
        return int(self.tables.knots[-1])

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
        nodes, soft = self.tables.extinction.to(extinction), self.tables.soft_extinction.to(extinction)
        # Not clamp: at the first node its gradient would add to that of the clamp below.
        thinner = torch.where(extinction < nodes[0], extinction / nodes[0], 1.0)[:, None]
        within = extinction.clamp(min=float(nodes[0])).clamp(max=float(nodes[-1]))
        of_extinction = cubic_weights(depth_coordinate(nodes, soft), depth_coordinate(within, soft))
        of_asymmetry = cubic_weights(self.tables.asymmetry, asymmetry)
        node_weights = (of_asymmetry[:, :, None] * of_extinction[:, None, :]).flatten(1)
        phase = evaluate_phase_function(self.cos_sun.to(asymmetry), asymmetry[:, None])
        power = albedo[:, None] * thinner * within[:, None]
        single = power * phase * (of_extinction @ self.log_single.to(albedo)).exp()
        mean = self._mean_of_images(asymmetry, within) * self._albedo_powers(albedo, thinner[:, 0], node_weights)
        multiple = self._compose_multiple(mean, node_weights)
        depth = extinction[:, None] * self.optical_length.to(albedo)
        return CloudLayers(single, multiple, torch.exp(-depth), -torch.expm1(-depth))

    def _mean_of_images(self, asymmetry: Tensor, extinction: Tensor) -> Tensor:
        """Means over the pixels `(population, knot)`; those of faint images may fall off a cliff, where a cubic would overshoot."""
        log_mean, slopes = self.log_mean.to(extinction), self.log_mean_slopes.to(extinction)
        soft = self.tables.soft_extinction.to(extinction)
        # Coordinates of nodes in the precision of the candidates': a first node that rounds above them would stop their gradient there.
        nodes = depth_coordinate(self.tables.extinction.to(extinction), soft)
        columns = interpolate_limited(nodes, log_mean, slopes, depth_coordinate(extinction, soft))
        columns = columns.unflatten(1, (len(self.relative), -1))
        power = _thin_powers(self.tables.knots).to(extinction) * extinction.log()[:, None]
        return (interpolate_limited_each(self.tables.asymmetry, columns, asymmetry) + power).exp()

    def _compose_multiple(self, mean: Tensor, node_weights: Tensor) -> Tensor:
        """Sum of the images with given means `(population, pixel)`."""
        images, nodes = list(range(len(self.relative))), torch.arange(node_weights.shape[1])
        if not mean.requires_grad:
            # A candidate lies among 16 nodes, and its high orders may be nothing: most of the tables need not be read.
            images = torch.nonzero((mean > SMALLEST_PART * mean.sum(1, keepdim=True)).any(0)).flatten().tolist()
            read = torch.nonzero(node_weights.any(0)).flatten()
            # Rows are copied to be left out, which costs more than it saves where most are wanted.
            nodes = read if 2 * len(read) < len(nodes) else nodes
        weights = node_weights.index_select(1, nodes)
        multiple = mean.new_zeros(len(mean), self.relative.shape[2])
        for number in images:
            relative = self.relative[number] if len(nodes) == self.relative.shape[1] else self.relative[number, nodes]
            # Cubic weights may be negative: next to a black pixel the interpolated image can fall a little below zero.
            multiple = torch.addcmul(multiple, mean[:, number, None], (weights @ relative.to(weights)).clamp(min=0.0))
        return multiple

    def _albedo_powers(self, albedo: Tensor, thinner: Tensor, node_weights: Tensor) -> Tensor:
        """(albedo thinner)^knot for each image `(population, knot)`, the last with the orders beyond it."""
        loss = albedo * thinner
        powers = [loss**knot for knot in self.tables.knots.tolist()]
        ratio, share = (
            node_weights @ values.flatten().to(albedo) for values in (self.tables.tail_ratio, self.tables.tail_share)
        )
        beyond = sum_tail(loss * ratio.clamp(0.0, 1.0), int(self.tables.knots[-1]))
        powers[-1] = powers[-1] * (1.0 + share.clamp(min=0.0) * beyond)
        return torch.stack(powers, dim=1)

    def estimated_error(self, asymmetry: Tensor, extinction: Tensor, albedo: Tensor) -> Tensor:
        """Relative RMS error of the composed image at the worst of the nodes around each candidate `(population,)`."""
        columns = _surrounding(self.tables.extinction, extinction)
        rows = _surrounding(self.tables.asymmetry, asymmetry)
        bright = bright_share(albedo)
        usual, brightest = self.tables.image_error.to(bright), self.tables.bright_error.to(bright)
        around = [torch.lerp(usual[row, column], brightest[row, column], bright) for row in rows for column in columns]
        return torch.stack(around).amax(0)

    def is_usable(self, asymmetry: Tensor, extinction: Tensor, albedo: Tensor) -> Tensor:
        """Whether all nodes around each candidate meet the accepted error at its albedo `(population,)` bool."""
        return self.estimated_error(asymmetry, extinction, albedo) <= self.largest_image_error


def bright_share(albedo: Tensor) -> Tensor:
    """How far an error has gone over to that at albedo one, 0..1 of the albedo's shape."""
    return ((albedo - BRIGHT_ALBEDO) / (1.0 - BRIGHT_ALBEDO)).clamp(0.0, 1.0)


def _thin_powers(knots: Tensor) -> Tensor:
    """Power of the extinction that each image is in a thin cloud: the lowest order that adds to it `(knot,)`, float64."""
    lowest = torch.cat([knots[:1], knots[:-1] + 1]) if len(knots) else knots
    return lowest.double()


def sum_tail(kept: Tensor, largest_order: int) -> Tensor:
    """Orders beyond the largest over the largest, if they fall like k^(-3/2) r^k.

        sum over j >= 1 of (1 + j/K)^(-3/2) (albedo r)^j

    The first terms are added one by one, the others as integrals over cells that grow by a tenth, up to 1e5 K.

    Args:
        kept: albedo times r, in 0..1 `(population,)`.
        largest_order: K.

    Returns:
        The sum `(population,)`, to 1 part in 1000.
    """
    edges = torch.logspace(math.log10(16.5), math.log10(1e5 * largest_order), 200, dtype=torch.float64)
    terms = torch.cat([torch.arange(1.0, 17.0, dtype=torch.float64), (edges[1:] * edges[:-1]).sqrt()]).to(kept)
    widths = torch.cat([torch.ones(16, dtype=torch.float64), edges.diff()]).to(kept)
    fall = widths * (1.0 + terms / largest_order) ** -1.5
    return (fall * torch.exp(terms * kept.clamp(min=1e-30).log()[:, None])).sum(1)


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
