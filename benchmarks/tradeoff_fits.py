"""Searches on photographs with stacks of several settings, all judged by the same renderings."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from rich.table import Table
from torch import Tensor

import cloudfit.fit_problem
from benchmarks.common import make_table, show, spread, stopwatch, tell_progress
from benchmarks.parameter_sets import Constant, varied
from benchmarks.reference_stack import merge_bins
from benchmarks.stack_settings import Setting
from benchmarks.synthetic_photograph import draw_truth, photograph_by_stack
from cloudfit.analysis import PhotographAnalysis, analyse_photograph
from cloudfit.colour_histogram import LEVELS, colour_histogram, haze_histograms
from cloudfit.fit_problem import FitProblem, resize_image, visible_share
from cloudfit.losses import LOSSES
from cloudfit.optimisers import DEFAULT_OPTIMISER, OPTIMISERS
from cloudfit.optimisers.base import Budget
from cloudfit.photograph import list_photographs, read_photograph
from cloudfit.picture import CandidateRendering
from cloudfit.scene import Scene
from precompute.error_budget import Effort
from render.errors import CloudfitError
from render.scattering_stack import ScatteringStack

FITTED_KNOBS = ("preset", "tolerance", "points", "orders", "smoothing", "storage", "bins", "resolution")
"""Knobs whose settings are also used to fit."""

EVALUATIONS, QUICK_EVALUATIONS = 1500, 60

LARGEST_SIDE = 1024
"""Of a photograph that is read [pixel]."""


@dataclass(frozen=True)
class FitLoss:
    """One search.

    Args:
        photograph: name.
        searched: objective of the best candidate on its stack, with the setting's bins.
        loss, floor: of the candidate's own rendering with 256 bins.
        wasserstein: of the same [level].
        seconds: of the search.
    """

    photograph: str
    searched: float
    loss: float
    floor: float
    wasserstein: float
    seconds: float


@dataclass(frozen=True, eq=False)
class FitPhotographs:
    """Photographs to fit.

    Args:
        scene: volume, camera and sun.
        effort: of the rendering that judges a candidate.
        evaluations: budget of each search.
        analyses: of the photographs by name.
        notes: sentences.
    """

    scene: Scene
    effort: Effort
    evaluations: int
    analyses: dict[str, PhotographAnalysis]
    notes: tuple[str, ...]

    @classmethod
    def prepare(cls, arguments: argparse.Namespace, scene: Scene, effort: Effort, folder: Path) -> "FitPhotographs":
        """Read photographs, or compose synthetic ones; none if no fits are asked for."""
        evaluations = QUICK_EVALUATIONS if arguments.quick else EVALUATIONS
        if not arguments.fits:
            return cls(scene, effort, evaluations, {}, ())
        if arguments.photographs is None:
            analyses, notes = _synthetic(arguments.fits, scene, effort, folder), [SYNTHETIC_NOTE]
        else:
            analyses, notes = _real(arguments.photographs, arguments.fits)
        return cls(scene, effort, evaluations, analyses, (*notes, FIT_NOTE))

    def fit(self, stack: ScatteringStack, setting: Setting) -> list[FitLoss]:
        """Search each photograph on the stack, and judge what was found; nothing for knobs that are not fitted."""
        if setting.knob not in FITTED_KNOBS:
            return []
        return [self._fit(name, analysis, stack, setting.bins) for name, analysis in self.analyses.items()]

    def _fit(self, name: str, analysis: PhotographAnalysis, stack: ScatteringStack, bins: int) -> FitLoss:
        budget = Budget(self.evaluations, None, None)
        with varied(_with_bins(bins)), stopwatch() as seconds:
            problem = FitProblem(analysis, stack)
            result = OPTIMISERS[DEFAULT_OPTIMISER].minimise(problem.evaluate, problem.space.dimension, budget, 0)
            physical = problem.space.to_physical(result.best[None])
        judge = FitProblem(analysis, stack)
        rendering = CandidateRendering(self.scene, judge.space.as_dict(physical[0]), self.effort)
        sky = resize_image(analysis.sky, self.scene.camera.width, self.scene.camera.height)
        lighting = judge.lighting(physical.to(torch.float32))
        air = rendering.search_air(lighting, sky, judge.target, judge.display_curve)
        found = FitLoss(
            name,
            result.best_loss,
            float(air.loss.mean()),
            judge.floor_of(int(visible_share(rendering.optical_length).sum())),
            float(LOSSES["wasserstein"](air.histogram[0], judge.target).mean()),
            seconds[0],
        )
        tell_progress(f"  {name}: searched {found.searched:.3f}, picture {found.loss:.3f}, floor {found.floor:.3f}")
        return found


FIT_NOTE = (
    f"fits: one search of {EVALUATIONS} evaluations; searched: the objective that the stack promised, with the row's bins; loss and grey "
    "levels: of the candidate rendered by itself, with 256 bins and the same effort in all rows"
)

SYNTHETIC_NOTE = "the photographs are synthetic, composed from stacks with the one true node, which shares its code with what is measured"


def _synthetic(count: int, scene: Scene, effort: Effort, folder: Path) -> dict[str, PhotographAnalysis]:
    analyses = {}
    for number in range(count):
        truth = draw_truth(torch.Generator().manual_seed(number))
        path = folder / "photographs" / f"{number:02d}.png"
        analyses[path.stem] = photograph_by_stack(scene, truth, path, effort, 2000 + number).analysis()
    return analyses


def _real(folder: Path, count: int) -> tuple[dict[str, PhotographAnalysis], list[str]]:
    analyses: dict[str, PhotographAnalysis] = {}
    notes: list[str] = []
    for path in list_photographs(folder):
        if len(analyses) == count:
            break
        try:
            analyses[path.stem] = analyse_photograph(read_photograph(path, max_side=LARGEST_SIDE))
        except CloudfitError as error:
            notes.append(f"{path.name} is not fitted: {error}")
    return analyses, notes


def _with_bins(bins: int) -> tuple[Constant, ...]:
    """Histograms of the objective with fewer bins."""
    if bins == LEVELS:
        return ()

    def merged_colour(pixels: Tensor, display_curve: str) -> Tensor:
        return merge_bins(colour_histogram(pixels, display_curve), bins)

    def merged_haze(cloud: Tensor, sky: Tensor, weights: Tensor, display_curve: str) -> Tensor:
        return merge_bins(haze_histograms(cloud, sky, weights, display_curve), bins)

    module = cloudfit.fit_problem
    return (module, "colour_histogram", merged_colour), (module, "haze_histograms", merged_haze)


def fit_table(fitted: Sequence[tuple[Setting, list[FitLoss]]]) -> Table:
    """Losses of each setting over the photographs."""
    columns = ("knob", "value", "searched", "loss", "loss / floor", "grey levels", "seconds")
    rows = [
        (
            setting.knob,
            setting.value,
            show(spread(fit.searched for fit in fits)),
            show(spread(fit.loss for fit in fits)),
            show(spread(fit.loss / fit.floor for fit in fits)),
            show(spread(fit.wasserstein for fit in fits)),
            spread(fit.seconds for fit in fits)["median"],
        )
        for setting, fits in fitted
    ]
    return make_table(f"Searches on {len(fitted[0][1])} photographs", columns, rows)
