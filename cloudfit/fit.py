"""Fit one photograph: search on the stack, then render the best distinct answers by themselves and rank them by that."""

import time
from collections.abc import Callable

import torch
from torch import Tensor

from cloudfit.analysis import PhotographAnalysis
from cloudfit.candidates import distinct_candidates
from cloudfit.determination import Determination, measure_determination
from cloudfit.fit_problem import FitProblem, resize_image
from cloudfit.fit_types import Candidate, FitOptions, PhotographFit
from cloudfit.losses import L1, LOSSES
from cloudfit.optimisers import OPTIMISERS
from cloudfit.picture import CandidateRendering
from cloudfit.scene import Scene
from cloudfit.search import SearchOutcome, search_parameters
from render.errors import ParameterError
from render.scattering_stack import ScatteringStack

BOUND_MARGIN = 0.005
"""A parameter within this share of its range from an end is reported as sitting on its bound."""

SURPRISE = 0.05
"""A picture whose L1 loss differs by more than this from what the stack promised is reported."""

RELATIVE_SURPRISE = 0.1
"""The same for losses in other units, as a share of the larger of both: what 0.05 is of the L1 losses of real photographs."""

DEFAULT_OPTIONS = FitOptions()

Progress = Callable[[str, float], None]


def fit_photograph(
    analysis: PhotographAnalysis,
    scene: Scene,
    stack: ScatteringStack,
    options: FitOptions = DEFAULT_OPTIONS,
    on_progress: Progress = lambda stage, share: None,
) -> PhotographFit:
    """Find the rendering parameters that make the volume look like the photograph.

    Args:
        analysis: of the photograph.
        scene: volume, full-size camera, sun.
        stack: of the scene, from `prepare_stack`.
        options: of the user.
        on_progress: called with a stage ("search", "pictures") and the share of it that is done.

    Returns:
        The ranked answers. If the search was interrupted, its incumbent alone.

    Raises:
        ParameterError: for an unknown optimiser or loss, or a method of gradients with a loss that has none.
    """
    if options.optimiser not in OPTIMISERS:
        raise ParameterError(f"no optimiser is called {options.optimiser!r}; there are {', '.join(OPTIMISERS)}")
    problem = _pose(analysis, stack, options)
    started = time.perf_counter()
    outcome = search_parameters(problem, options, on_progress)
    result = outcome.final
    searched = time.perf_counter()
    chosen, determination = _compare_answers(problem, outcome, options)
    compared = time.perf_counter()
    candidates = []
    for number, index in enumerate(chosen.tolist()):
        on_progress("pictures", number / len(chosen))
        physical = problem.space.to_physical(result.evaluated[index : index + 1])
        candidates.append(_render_candidate(problem, scene, options, physical, float(result.losses[index])))
    on_progress("pictures", 1.0)
    candidates.sort(key=lambda candidate: candidate.loss)
    return PhotographFit(
        analysis=analysis,
        candidates=tuple(candidates),
        histogram=problem.target,
        history=tuple(outcome.history.tolist()),
        evaluations=outcome.evaluations,
        iterations=len(outcome.history),
        stop_reason=result.stop_reason.value,
        interrupted=outcome.interrupted,
        seconds={
            "search": searched - started,
            "comparing answers": compared - searched,
            "pictures": time.perf_counter() - compared,
        },
        warnings=(*analysis.warnings, *describe_doubts(problem, candidates[0])),
        determination=determination,
    )


def _pose(analysis: PhotographAnalysis, stack: ScatteringStack, options: FitOptions) -> FitProblem:
    """The problem that the options ask for."""
    return FitProblem(
        analysis, stack, options.ambient, options.transfer, options.air_refinements, options.loss, options.coarse_air
    )


def _compare_answers(
    problem: FitProblem, outcome: SearchOutcome, options: FitOptions
) -> tuple[Tensor, Determination | None]:
    """The best distinct answers among nearly equal ones, and what these have in common; nothing of that after an interruption.

    Nearly equal are losses within a tenth of the best, and all below the floor, which are as good as a loss can tell. What they have in
    common is found out on the sample that was searched, where there are more of them.
    """
    final, coarse, sampled = outcome.final, outcome.coarse, outcome.sampled
    count = 1 if outcome.interrupted else options.candidates
    below_floor = max(0.0, problem.floor - final.best_loss)
    chosen = distinct_candidates(
        final.evaluated, final.losses, count, absolute_excess=below_floor, appearance=problem.appearance
    )
    if outcome.interrupted:
        return chosen, None
    below_floor = max(0.0, sampled.floor - coarse.best_loss)
    determination = measure_determination(
        sampled, sampled.space, coarse.evaluated, coarse.losses, below_floor, options.seed
    )
    return chosen, determination


def _render_candidate(
    problem: FitProblem, scene: Scene, options: FitOptions, physical: Tensor, promised: float
) -> Candidate:
    """Render one answer by itself, search its air again and score it on that picture."""
    parameters = problem.space.as_dict(physical[0])
    rendering = CandidateRendering(scene, parameters, options.quality.picture_effort, options.seed)
    lighting = problem.lighting(physical.to(torch.float32))
    sky = resize_image(problem.analysis.sky, scene.camera.width, scene.camera.height)
    comparison = problem.comparison_at(scene.camera.width, scene.camera.height, rendering.counted)
    air = rendering.compare(lighting, sky, comparison, options.air_refinements, options.coarse_air)
    red, green, blue = air.air_depth[0].tolist()
    return Candidate(
        parameters=parameters,
        air_depth=(red, green, blue),
        promised_loss=promised,
        loss=float(air.loss.mean()),
        wasserstein=float(LOSSES["wasserstein"](air.histogram[0], problem.target).mean()),
        floor=problem.floor_of(len(rendering.counted)),
        picture=rendering.picture(lighting, sky, air.air_depth[0]),
        histogram=air.histogram[0],
    )


def describe_doubts(problem: FitProblem, best: Candidate) -> list[str]:
    """Sentences about an answer that a user should not trust blindly."""
    unit = problem.space.to_unit(torch.tensor([list(best.parameters.values())]))[0]
    warnings = []
    for parameter, place in zip(problem.space.parameters, unit.tolist(), strict=True):
        if place < BOUND_MARGIN or place > 1.0 - BOUND_MARGIN:
            end = "lower" if place < 0.5 else "upper"
            warnings.append(
                f"{parameter.name} sits on the {end} bound of its range; the scene may not be able to match the photograph."
            )
    larger = max(best.loss, best.promised_loss)
    if abs(best.loss - best.promised_loss) > (SURPRISE if problem.loss == L1.name else RELATIVE_SURPRISE * larger):
        warnings.append(
            f"the picture's own loss is {best.loss:.3f}, the stack promised {best.promised_loss:.3f}; a higher quality narrows the gap."
        )
    left_out = 1.0 - float(problem.stack.usable.float().mean())
    if left_out > 0.0:
        warnings.append(
            f"{left_out:.0%} of the table's nodes missed the accepted error and were left out of the search."
        )
    return warnings
