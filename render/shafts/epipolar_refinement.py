"""More samples on epipolar lines, and more pixels of their own, where what has been marched differs from place to place.

Edges of depth tell where light may jump; what was marched tells where it does. Engelhardt & Dachsbacher 2010 refine at the former.
Halving the gap between two marched samples of unlike light, again and again, finds an edge of a shadow among n dense samples with
log2(n) rays. Between lines no sample can be added, so there the pixels themselves are marched.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from render.errors import ParameterError
from render.fused import fused_loops_wanted
from render.shafts.epipolar_sampling import EpipolarSampling, pair_samples


@dataclass(frozen=True, eq=False)
class RefinedSampling:
    """A denser sampling, and what is new in it.

    Args:
        sampling: the denser one.
        fresh: True for the marched samples that have no values yet `(marched,)`.
    """

    sampling: EpipolarSampling
    fresh: Tensor

    def merge(self, known: Tensor, new: Tensor) -> Tensor:
        """Values of all marched samples.

        Args:
            known: of the sampling before `(old marched, channel)`.
            new: of the fresh samples, in their order `(fresh, channel)`.

        Returns:
            Values `(marched, channel)`.
        """
        values = known.new_empty(len(self.fresh), known.shape[1])
        values[self.fresh], values[~self.fresh] = new, known
        return values


def halve_gaps(sampling: EpipolarSampling, values: Tensor, contrast: float) -> RefinedSampling:
    """March the middle of every gap between marched samples of one line and surface whose light differs.

    Args:
        sampling: the samples.
        values: light of the marched ones `(marched, channel)`.
        contrast: largest difference of any channel that may stay, at least 0, in the unit of the light.

    Returns:
        The sampling with the middles marched too; nothing is fresh once all gaps are closed or of like light.

    Raises:
        ParameterError: for another number of values, or a contrast that is negative or NaN.
    """
    _check(sampling, values, contrast)
    low, high = sampling.marched[:-1], sampling.marched[1:]
    differs = (values[1:] - values[:-1]).abs().amax(1) > contrast
    # Neighbours across an edge of depth or on two lines have no dense sample between them.
    halved = (low + (high - low) // 2)[differs & (high - low > 1)]
    marked = sampling.refined
    new = torch.zeros_like(marked)
    new[halved] = True
    marked |= new
    neighbours, share = pair_samples(marked)
    marched = torch.nonzero(marked)[:, 0]
    return RefinedSampling(replace(sampling, marched=marched, neighbours=neighbours, share=share), new[marched])


def separate_pixels(sampling: EpipolarSampling, values: Tensor, contrast: float) -> EpipolarSampling:
    """Take pixels for marching by themselves whose samples differ.

    Args:
        sampling: the samples.
        values: light of the marched ones `(marched, channel)`.
        contrast: largest difference of any channel that may stay, at least 0, in the unit of the light.

    Returns:
        The sampling with more pixels of their own.

    Raises:
        ParameterError: for another number of values, or a contrast that is negative or NaN.
    """
    _check(sampling, values, contrast)
    spread = spread_of_pixels(sampling.interpolate_lines(values), sampling.pixel_samples, sampling.pixel_weights)
    apart = spread > contrast
    apart[sampling.own_pixels] = True
    return replace(sampling, own_pixels=torch.nonzero(apart)[:, 0])


def spread_of_pixels(dense: Tensor, samples: Tensor, weights: Tensor) -> Tensor:
    """Largest difference of the samples that enter each pixel.

    Args:
        dense: values of the dense samples `(sample, channel)`.
        samples, weights: `pixel_samples` and `pixel_weights` of the sampling `(pixel, 4)`.

    Returns:
        The difference of the channel that differs most `(pixel,)`; 0 for pixels that no sample enters.
    """
    if dense.dtype == torch.float32 and fused_loops_wanted(dense, weights):
        from render.shafts import fused_epipolar  # needs numba

        return fused_epipolar.spread_of_pixels(dense, samples, weights)
    rows = dense.index_select(0, samples.reshape(-1)).reshape(len(samples), 4, -1)
    enters = (weights > 0.0)[..., None]
    most, least = (torch.where(enters, rows, sign * torch.inf) for sign in (-1.0, 1.0))
    return torch.where(enters.any(1), most.amax(1) - least.amin(1), 0.0).amax(1)


def _check(sampling: EpipolarSampling, values: Tensor, contrast: float) -> None:
    if len(values) != len(sampling.marched):
        raise ParameterError(f"{len(sampling.marched)} samples are marched, but values of {len(values)} came")
    if not contrast >= 0.0:
        raise ParameterError(f"the contrast that may stay must be at least 0, not {contrast}")
