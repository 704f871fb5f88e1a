"""The objective: the only place that knows both the scattering stack and the photograph.

    O = mean over channels of min over kappa of loss(image behind air kappa, photograph)

With the default loss, sum over 256 levels |h_image - h_photo|, this is equation 2 of Dobashi et al. 2012.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import torch
from torch import Tensor

from cloudfit.air_search import Comparison
from cloudfit.analysis import PhotographAnalysis
from cloudfit.colour_histogram import colour_histogram
from cloudfit.fit_types import AIR_REFINEMENTS
from cloudfit.losses import DEFAULT_LOSS, L1, AnyLoss, Loss, PhotographValues, find_loss, l1_floor, sampled_floor
from cloudfit.parameters import Ambient, SearchSpace, cloud_search_space
from cloudfit.soft_haze import display_values
from render.cloud_image import Lighting, compose_cloud
from render.phase_functions import evaluate_phase_function
from render.scattering_stack import CloudLayers, ScatteringStack

FAINTEST_SHARE = 0.02
"""Pixels whose optical length is a smaller share of the largest are fringes that no mask would call cloud."""

SUNLIGHT_HEADROOM = 2.0
"""Brightest reachable grey over the photograph's: room for an albedo below one and for air in front."""

DARKEST_ALBEDO = 0.8
"""Of clouds that shall reach the photograph's brightest grey; for those that absorb more, no sunlight is looked for."""

SUNLIGHT_SPAN = 1000.0
"""Strongest over weakest sunlight that is searched."""

POPULATION_CHUNK = 32
"""Candidates composed at once; bounds the memory."""

GRADIENT_CHUNK = 8
"""The same where all that was composed must be kept for its gradients."""

SAMPLED_PIXELS = 500
"""Enough to tell whether two pictures differ by a level."""

Gradient = Callable[[Tensor], tuple[Tensor, Tensor]]


def resize_image(image: Tensor, width: int, height: int) -> Tensor:
    """Image `(height, width, channel)` averaged or interpolated to another size."""
    shrinks = width * height < image.shape[0] * image.shape[1]
    method = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    return torch.from_numpy(cv2.resize(image.contiguous().numpy(), (width, height), interpolation=method))


def visible_share(optical_length: Tensor) -> Tensor:
    """Which cloud pixels count in histograms `(pixel,)` bool."""
    return optical_length > FAINTEST_SHARE * optical_length.max()


def brightest_radiance(stack: ScatteringStack) -> float:
    """Radiance of the cloud's bright parts for unit sunlight and an albedo of 0.8, at the asymmetry that is worst off.

    The 95th percentile over the pixels is taken at each node, then the largest over extinction and the smallest over asymmetry: a
    thin cloud could only reach the same with a sun that no thick one needs.
    """
    tables = stack.tables
    rank = max(1, math.ceil(0.95 * len(tables.pixel)))
    powers = DARKEST_ALBEDO**tables.knots
    brightest = []
    for number, asymmetry in enumerate(tables.asymmetry):
        phase = evaluate_phase_function(tables.cos_sun, asymmetry)
        total = DARKEST_ALBEDO * phase * tables.single + torch.einsum("k,ksp->sp", powers, tables.multiple[:, number])
        brightest.append(float(total.kthvalue(rank, dim=1).values.max()))
    return max(min(brightest), 1e-12)


@dataclass(frozen=True, eq=False)
class FitProblem:
    """Losses of whole populations in the unit cube.

    It computes in the precision of the stack: float32, or float64 after `stack.double()`.

    Args:
        analysis: of the photograph.
        stack: of the scene.
        ambient: colour of the ambient light.
        display_curve: applied to both sides before they are compared.
        air_refinements: of the search over the air; 0 is the paper's.
        loss: name in LOSSES.
        coarse_air: whether the search over the air begins with every third depth.
        searched_space: the searched parameters, or None for those that suit stack and photograph.

    Raises:
        ParameterError: when there is no such loss.
    """

    analysis: PhotographAnalysis
    stack: ScatteringStack
    ambient: Ambient = "sun"
    display_curve: str = "srgb"
    air_refinements: int = AIR_REFINEMENTS
    loss: str = DEFAULT_LOSS
    coarse_air: bool = False
    searched_space: SearchSpace | None = None

    def __post_init__(self) -> None:
        find_loss(self.loss)

    @cached_property
    def space(self) -> SearchSpace:
        """The searched parameters; sunlight just strong enough for the photograph's brightest cloud at every asymmetry."""
        if self.searched_space is not None:
            return self.searched_space
        tables = self.stack.tables
        strongest = SUNLIGHT_HEADROOM * self._brightest_grey / brightest_radiance(self.stack)
        return cloud_search_space(
            tables.largest_optical_length,
            self.ambient,
            (float(tables.extinction[0]), float(tables.extinction[-1])),
            (float(tables.asymmetry[0]), float(tables.asymmetry[-1])),
            (strongest / SUNLIGHT_SPAN, strongest),
        )

    @cached_property
    def _brightest_grey(self) -> float:
        """99th percentile of the photograph's grey cloud pixels, at most display white."""
        grey = self.analysis.photograph.pixels[self.analysis.mask.cloud].mean(1).clamp(0.0, 1.0)
        return max(float(grey.kthvalue(math.ceil(0.99 * len(grey))).values), 1.0 / 255.0)

    @cached_property
    def target(self) -> Tensor:
        """Histogram of the photograph's cloud pixels `(channel, bin)`."""
        pixels = self.analysis.photograph.pixels[self.analysis.mask.cloud]
        return colour_histogram(pixels, self.display_curve)

    @cached_property
    def counted(self) -> Tensor:
        """Numbers of the stack's cloud pixels that count in the histogram."""
        return torch.nonzero(visible_share(self.stack.optical_length)).flatten()

    @cached_property
    def sky(self) -> Tensor:
        """Sky behind the counted pixels `(channel, pixel)`."""
        image = resize_image(self.analysis.sky, self.stack.tables.width, self.stack.tables.height)
        return image.flatten(0, 1)[self.stack.pixel[self.counted]].T.contiguous()

    @cached_property
    def comparison(self) -> Comparison:
        """The photograph as the loss sees it, for the stack's counted pixels."""
        tables = self.stack.tables
        return self.comparison_at(tables.width, tables.height, self.stack.pixel[self.counted])

    def comparison_at(self, width: int, height: int, pixel: Tensor) -> Comparison:
        """The photograph as the loss sees it, for a rendering of any size.

        Args:
            width, height: of the rendering.
            pixel: numbers of its counted pixels `(pixel,)`.
        """
        loss = find_loss(self.loss)
        if isinstance(loss, Loss):
            return Comparison(loss, self.target, self.target, self.display_curve)
        resized = resize_image(self.analysis.photograph.pixels, width, height).flatten(0, 1)[pixel].T
        values = PhotographValues(self._cloud_values, display_values(resized, self.display_curve))
        return Comparison(loss, loss.prepare(values), self.target, self.display_curve)

    @cached_property
    def _cloud_values(self) -> Tensor:
        """Display values of the photograph's cloud pixels `(channel, sample)`."""
        pixels = self.analysis.photograph.pixels[self.analysis.mask.cloud]
        return display_values(pixels.T, self.display_curve).contiguous()

    @cached_property
    def floor(self) -> float:
        """Loss that two images of equal appearance reach on the stack's pixels; nothing below it can be told apart."""
        return self.floor_of(len(self.counted))

    def floor_of(self, pixels: int) -> float:
        """The floor for a picture with so many counted pixels: that of two samples as large as the harmonic mean of both.

        Zero for a loss that compares pixels in their places, which says nothing of images that are merely alike.
        """
        photographed = int(self.analysis.mask.cloud.sum())
        size = max(1, round(2.0 / (1.0 / photographed + 1.0 / pixels)))
        loss = find_loss(self.loss)
        if loss is L1:
            return float(l1_floor(self.target, size).mean())
        if not isinstance(loss, Loss) and loss.is_paired:
            return 0.0
        return float(sampled_floor(_compare_samples(loss), self._cloud_values, size).mean())

    def lighting(self, physical: Tensor) -> Lighting:
        """Light of candidates in units `(population, parameter)`."""
        sunlight = self.analysis.sunlight
        column = {name: physical[:, number] for number, name in enumerate(self.space.names)}
        colour = {"sun": sunlight.colour, "sky": sunlight.ambient_sky_colour}.get(self.ambient)
        if colour is None:
            colour = torch.stack([column[f"ambient_{name}"] for name in ("red", "green", "blue")], dim=1)
        return Lighting(column["sunlight_intensity"], sunlight.colour, column["ambient"], colour)

    def compose(self, physical: Tensor) -> Tensor:
        """Radiance of the counted pixels without air `(population, channel, pixel)`; differentiable."""
        column = {name: physical[:, number] for number, name in enumerate(self.space.names)}
        layers = self.stack(column["asymmetry"], column["extinction"], column["albedo"])
        counted = CloudLayers(
            layers.single[:, self.counted],
            layers.multiple[:, self.counted],
            layers.transmittance[:, self.counted],
            layers.opacity[:, self.counted],
        )
        return compose_cloud(counted, self.lighting(physical), self.sky)

    @torch.no_grad()
    def appearance(self, population: Tensor) -> Tensor:
        """Display levels 0..255 of a sample of the counted pixels, without air: cheap, for telling pictures apart.

        Args:
            population: `(population, parameter)` in the unit cube.

        Returns:
            `(population, channel x sampled pixel)`.
        """
        cloud = self.sampled(SAMPLED_PIXELS).compose(self.space.to_physical(population))
        return 255.0 * display_values(cloud, self.display_curve).flatten(1)

    def sampled(self, pixels: int | None) -> "FitProblem":
        """The same problem on fewer pixels, evenly spread.

        Args:
            pixels: about how many of the counted ones, at least; None for all.

        Returns:
            The smaller problem, with the same search space, or this one if it has not twice as many.
        """
        stride = 1 if pixels is None else len(self.counted) // pixels
        if stride < 2:
            return self
        if stride not in self._samples:
            self._samples[stride] = self._every(stride)
        return self._samples[stride]

    @cached_property
    def _samples(self) -> dict[int, "FitProblem"]:
        """By stride."""
        return {}

    def _every(self, stride: int) -> "FitProblem":
        """The same problem on every so many of the counted pixels."""
        tables = self.stack.tables
        chosen = self.counted[::stride]
        fewer = replace(
            tables,
            pixel=tables.pixel[chosen],
            optical_length=tables.optical_length[chosen],
            cos_sun=tables.cos_sun[chosen],
            single=tables.single[:, chosen],
            multiple=tables.multiple[..., chosen],
        )
        stack = ScatteringStack(fewer, self.stack.largest_image_error)
        return replace(self, stack=stack.to(self.precision), searched_space=self.space)

    def __call__(self, population: Tensor) -> Tensor:
        """Objective of candidates; see `evaluate`."""
        return self.evaluate(population)

    @property
    def precision(self) -> torch.dtype:
        """Of everything that is composed."""
        return self.stack.log_single.dtype

    @torch.no_grad()
    def evaluate(self, population: Tensor) -> Tensor:
        """Objective of candidates.

        Args:
            population: `(population, parameter)` in the unit cube.

        Returns:
            Losses `(population,)`, float64; candidates between table nodes that miss the accepted error get the worst loss.
        """
        losses = []
        for part in population.split(POPULATION_CHUNK):
            physical = self.space.to_physical(part.to(self.precision))
            cloud = self.compose(physical)
            found = self.comparison.find_air(cloud, self.sky, self.air_refinements, self.coarse_air)
            losses.append(self._refuse(physical, found.loss.mean(1)))
        return torch.cat(losses)

    @property
    def with_gradient(self) -> Gradient:
        """The objective with its gradient: `(population, parameter)` -> losses `(population,)` and gradient `(population, parameter)`.

        Both as `evaluate` has them, in the unit cube; the losses are float64, the gradient has the precision of the stack. The gradient is
        taken behind the best air found, which is held: it takes few values, so that it stays the same when the parameters change by
        little, and at a true minimum over the air the loss does not depend on it to first order (envelope theorem). A candidate
        that is left out of the search has the gradient zero.

        Raises:
            AttributeError: when the loss is not differentiable, so that `hasattr` tells which problem has gradients.
        """
        if not find_loss(self.loss).is_differentiable:
            raise AttributeError(f"the loss {self.loss!r} is a step function and has no useful gradient")
        return self._evaluate_with_gradient

    def _evaluate_with_gradient(self, population: Tensor) -> tuple[Tensor, Tensor]:
        losses, gradients = [], []
        for part in population.split(GRADIENT_CHUNK):
            unit = part.detach().to(self.precision).clone().requires_grad_()
            with torch.enable_grad():
                physical = self.space.to_physical(unit)
                cloud = self.compose(physical)
                with torch.no_grad():
                    found = self.comparison.find_air(cloud, self.sky, self.air_refinements, self.coarse_air)
                behind_air = self.comparison.score(cloud, self.sky, found.air_depth[:, None])[:, 0]
                loss = self._refuse(physical, behind_air.mean(1))
                gradients.append(torch.autograd.grad(loss.sum(), unit)[0])
            losses.append(loss.detach())
        return torch.cat(losses), torch.cat(gradients)

    def _refuse(self, physical: Tensor, losses: Tensor) -> Tensor:
        """Losses `(population,)`, the worst for candidates between nodes that miss the accepted error."""
        usable = self.stack.is_usable(physical[:, 1], physical[:, 2], physical[:, 3])
        return torch.where(usable, losses, find_loss(self.loss).worst)


def _compare_samples(loss: AnyLoss) -> Callable[[Tensor, Tensor], Tensor]:
    """Loss between display values of two samples of pixels `(channel, pixel)`."""
    if isinstance(loss, Loss):
        return lambda first, second: loss(_count_levels(first), _count_levels(second))
    return lambda first, second: loss(first, loss.prepare(PhotographValues(second, second)))


def _count_levels(values: Tensor) -> Tensor:
    return (
        torch.stack([torch.bincount((255.0 * row).round().long(), minlength=256) for row in values]) / values.shape[1]
    )
