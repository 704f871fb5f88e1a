"""What a fit is told and what it gives back."""

from dataclasses import dataclass

from torch import Tensor

from cloudfit.analysis import PhotographAnalysis
from cloudfit.determination import Determination
from cloudfit.losses import DEFAULT_LOSS
from cloudfit.optimisers import DEFAULT_OPTIMISER
from cloudfit.parameters import LARGEST_OPTICAL_DEPTH_RANGE, Ambient
from cloudfit.quality import QUALITIES, Quality

AIR_STEP = 0.3

AIR_DEPTHS = tuple(AIR_STEP * step for step in range(11))
"""Optical depths kappa_a t_c that the linear search over the air tries first for each channel: the paper's 11."""

AIR_REFINEMENTS = 2
"""Times that the air's step is then cut to a third, with one more depth on either side of the best: down to 0.033 by default.

Against an exhaustive search in steps of 0.033, on four synthetic photographs (148 candidates: the truth, near it, far from it and
random), the 11 depths alone end 0.42 loss floors too high on average, 2.7 at worst, and worst at the truth. Two refinements
end 0.008 too high, 0.25 at worst, for the loss is jagged; four depths a refinement would end 0.0001 too high, 0.009 at worst, for twice
the price, and a third refinement would gain 0.02.
"""


SEARCH_PIXELS = 4000
"""Of the sample on which a search runs, at least."""


@dataclass(frozen=True)
class FitOptions:
    """Choices of the user.

    Args:
        quality: preset of effort and accuracy.
        optical_depths: of the densest view ray, thinnest and thickest that are searched; tables cover just these.
        ambient: colour of the ambient light: the sun's (the paper), the sky's, or three more searched parameters.
        transfer: display curve applied to both sides before a histogram, "srgb" or "none".
        optimiser: name in OPTIMISERS.
        evaluations: budget of all searches together, or None for the optimiser's own limit.
        seconds: budget of all searches together, or None.
        searches: independent runs of the optimiser whose answers are pooled and which share the budgets; the loss has
            many local optima.
        candidates: distinct answers to render again and rank.
        seed: of every random stream.
        air_refinements: times that the step of the search over the air is cut to a third; 0 is the paper's search.
        loss: name in LOSSES; what the search and the search over the air make small, and by which answers are ranked.
        search_pixels: about how many of the cloud's pixels the optimiser sees, at least; the best of what it finds is settled on all of
            them. None: it sees all.
        coarse_air: whether the search over the air begins with every third of the 11 depths: two thirds of the comparisons, but of 400
            random candidates of one photograph 28 % got a higher loss, over all by 0.8 loss floors on average and 44 at worst.
    """

    quality: Quality = QUALITIES["standard"]
    ambient: Ambient = "sun"
    transfer: str = "srgb"
    optimiser: str = DEFAULT_OPTIMISER
    evaluations: int | None = None
    seconds: float | None = None
    searches: int = 3
    candidates: int = 3
    seed: int = 0
    air_refinements: int = AIR_REFINEMENTS
    loss: str = DEFAULT_LOSS
    search_pixels: int | None = SEARCH_PIXELS
    coarse_air: bool = False
    optical_depths: tuple[float, float] = LARGEST_OPTICAL_DEPTH_RANGE


@dataclass(frozen=True, eq=False)
class Picture:
    """A candidate rendered by itself at full size; linear, `(height, width, 3)` or `(height, width)` for grey layers.

    Args:
        rgb: the image.
        single: singly scattered sunlight in front of the viewer, after the air, `(height, width, 3)`.
        multiple: sunlight scattered more often, likewise.
        ambient: ambient light, likewise.
        sky: light of the sky and the air, likewise; the four sum to `rgb`.
        transmittance: of the cloud `(height, width)`.
        image_error: estimated relative RMS error of the cloud pixels.
        seconds: time it took.
    """

    rgb: Tensor
    single: Tensor
    multiple: Tensor
    ambient: Tensor
    sky: Tensor
    transmittance: Tensor
    image_error: float
    seconds: float


@dataclass(frozen=True, eq=False)
class Candidate:
    """One answer.

    Args:
        parameters: searched parameters by name, in units.
        air_depth: optical depth of the air, red, green, blue.
        promised_loss: loss that the stack promised.
        loss: of the picture rendered by itself.
        wasserstein: mean distance of the picture's histograms from the photograph's [grey levels of 255].
        floor: loss of two images of equal appearance with as many pixels; zero for a loss that compares pixels in their places.
        picture: full-size rendering.
        histogram: of the picture's cloud pixels `(channel, bin)`.
    """

    parameters: dict[str, float]
    air_depth: tuple[float, float, float]
    promised_loss: float
    loss: float
    wasserstein: float
    floor: float
    picture: Picture
    histogram: Tensor


@dataclass(frozen=True, eq=False)
class PhotographFit:
    """Everything a fit found out about one photograph.

    Args:
        analysis: mask, filled sky, sunlight.
        candidates: best first, by the loss of their own pictures.
        histogram: of the photograph's cloud pixels `(channel, bin)`.
        history: best loss after each iteration.
        evaluations: candidates tried.
        iterations: generations or steps.
        stop_reason: sentence.
        interrupted: whether Ctrl-C ended the search.
        seconds: by stage: "search", "comparing answers", "pictures".
        warnings: sentences.
        determination: which parameters the photograph determines; None after an interruption.
    """

    analysis: PhotographAnalysis
    candidates: tuple[Candidate, ...]
    histogram: Tensor
    history: tuple[float, ...]
    evaluations: int
    iterations: int
    stop_reason: str
    interrupted: bool
    seconds: dict[str, float]
    warnings: tuple[str, ...]
    determination: Determination | None = None
