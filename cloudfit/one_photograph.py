"""One photograph of a batch, from the file to its folder of results; whatever goes wrong becomes a reason on disk."""

import hashlib
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from torch import Tensor

from cloudfit.analysis import NoCloudError, PhotographAnalysis, analyse_photograph
from cloudfit.cloud_mask import read_user_mask
from cloudfit.fit import fit_photograph
from cloudfit.fit_problem import FitProblem
from cloudfit.fit_types import FitOptions, PhotographFit
from cloudfit.parameters import SearchSpace
from cloudfit.photograph import Photograph, read_photograph
from cloudfit.result import Question, read_result, result_matches
from cloudfit.result_document import Circumstances, describe_fit, describe_reason
from cloudfit.result_folder import write_fit, write_reason
from cloudfit.scene import Scene
from cloudfit.stack import prepare_stack
from precompute.stack_store import StackReport
from render.errors import CloudfitError
from render.scattering_stack import ScatteringStack

Progress = Callable[[str, float], None]


def searched_space(analysis: PhotographAnalysis, stack: ScatteringStack, options: FitOptions) -> SearchSpace:
    """Ranges that the fit searches."""
    return FitProblem(analysis, stack, options.ambient, options.transfer).space


@dataclass(frozen=True)
class Stages:
    """The steps of a fit; others can stand in for them.

    Args:
        read: photograph from a file.
        analyse: clouds, sky and sunlight of a photograph, with the user's labels or None.
        prepare_stack: scattering stack of a scene.
        fit: the search and its pictures.
        space: ranges that are searched.
    """

    read: Callable[[Path], Photograph] = read_photograph
    analyse: Callable[[Photograph, Tensor | None], PhotographAnalysis] = analyse_photograph
    prepare_stack: Callable[..., tuple[ScatteringStack, StackReport]] = prepare_stack
    fit: Callable[..., PhotographFit] = fit_photograph
    space: Callable[[PhotographAnalysis, ScatteringStack, FitOptions], SearchSpace] = searched_space


ALL_STAGES = Stages()


@dataclass(frozen=True)
class Job:
    """One photograph and where its results go.

    Args:
        photograph: the file.
        mask: the user's mask, or None.
        folder: of the results; its parent must exist.
    """

    photograph: Path
    mask: Path | None
    folder: Path


@dataclass(frozen=True)
class Outcome:
    """What became of a photograph.

    Args:
        job: which one.
        status: "done", "no_cloud" or "failed".
        reason: sentence, or None for a fit.
        kept: whether an earlier run had done it.
        interrupted: whether Ctrl-C ended its search.
        loss, floor: of the best picture [1].
        wasserstein: of the best picture [grey levels of 255].
        seconds: it took, in the run that did it.
        peak_memory_mb: largest memory of the process up to then [MiB].
        details: text of an unexpected error, with its traceback.
    """

    job: Job
    status: str
    reason: str | None = None
    kept: bool = False
    interrupted: bool = False
    loss: float | None = None
    floor: float | None = None
    wasserstein: float | None = None
    seconds: float | None = None
    peak_memory_mb: float | None = None
    details: str = ""


@dataclass(eq=False)
class StackSource:
    """The batch's stack, built or loaded when it is first needed and then kept.

    Args:
        scene: that it belongs to.
        options: with quality and seed.
        tables: folder of stack files, or None.
        stages: with the builder.
    """

    scene: Scene
    options: FitOptions
    tables: Path | None
    stages: Stages
    stack: ScatteringStack | None = field(default=None, init=False)
    report: StackReport | None = field(default=None, init=False)

    def get(self, on_progress: Progress) -> ScatteringStack:
        """The stack.

        Raises:
            StackUnavailableError: it can be neither loaded nor built; no photograph can be fitted then.
        """
        if self.stack is None:
            try:
                self.stack, self.report = self.stages.prepare_stack(
                    self.scene,
                    self.options.quality,
                    self.options.seed,
                    self.tables,
                    on_progress,
                    self.options.optical_depths,
                )
            except (CloudfitError, OSError) as error:
                raise StackUnavailableError(str(error)) from error
        return self.stack


class StackUnavailableError(Exception):
    """Carries the error that ends a whole batch past the handlers of one photograph; its cause is the error itself."""


def file_sha256(path: Path | None) -> str | None:
    """Hash of a file's bytes; None without a file or if it cannot be read."""
    if path is None:
        return None
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None


def ask(job: Job, scene: Scene, options: FitOptions) -> Question:
    """Everything that the result of a job depends on."""
    return Question(file_sha256(job.photograph), file_sha256(job.mask), scene, options)


def kept_outcome(job: Job, question: Question) -> Outcome | None:
    """Outcome of an earlier run that answered just this question, or None."""
    if not result_matches(job.folder, question.fingerprint()):
        return None
    return outcome_from_document(job, read_result(job.folder), kept=True)


def outcome_from_document(job: Job, document: dict[str, Any], kept: bool = False) -> Outcome:
    """The gist of a result."""
    best = document["candidates"][0] if document["status"] == "done" else {}
    return Outcome(
        job=job,
        status=document["status"],
        reason=document["reason"],
        kept=kept,
        interrupted=document["interrupted"],
        loss=best.get("loss"),
        floor=best.get("floor"),
        wasserstein=best.get("wasserstein_levels"),
        seconds=document["seconds"]["total"],
        peak_memory_mb=document.get("peak_memory_mb"),
    )


def treat_photograph(
    job: Job, question: Question, source: StackSource, token: str, on_progress: Progress = lambda stage, share: None
) -> Outcome:
    """Fit one photograph and write its folder.

    Args:
        job: the photograph.
        question: from `ask`.
        source: of the stack.
        token: marks temporary folders.
        on_progress: called with a stage and the share of it that is done.

    Returns:
        What became of it; every error of this photograph alone is in there and on disk.

    Raises:
        StackUnavailableError: no photograph can be fitted.
        KeyboardInterrupt: the user asked to stop; nothing was written.
    """
    clock = _Clock()
    photograph: Photograph | None = None
    details = ""
    try:
        on_progress("reading", 0.0)
        photograph = source.stages.read(job.photograph)
        clock.lap("reading")
        return _fit(job, question, source, photograph, clock, token, on_progress)
    except NoCloudError as error:
        status, reason = "no_cloud", str(error)
    except CloudfitError as error:
        status, reason = "failed", str(error)
    except StackUnavailableError:
        raise
    except Exception as error:  # one photograph never ends a batch
        status, reason, details = "failed", f"{job.photograph}: {_sentence(error)}", traceback.format_exc()
    clock.lap("reading" if photograph is None else "until it failed")
    return record_reason(job, question, (status, reason), token, photograph, clock.laps(), details)


def record_reason(
    job: Job,
    question: Question,
    verdict: tuple[str, str],
    token: str,
    photograph: Photograph | None = None,
    seconds: Mapping[str, float] = MappingProxyType({"total": 0.0}),
    details: str = "",
) -> Outcome:
    """Write down why a photograph was not fitted.

    Args:
        job: the photograph.
        question: from `ask`.
        verdict: "failed" or "no_cloud", and the sentence that says why.
        token: marks temporary folders.
        photograph: to be shown, if it could be read.
        seconds: by stage.
        details: text of an unexpected error, with its traceback.

    Returns:
        The outcome; if not even the reason can be written, it says that too.
    """
    status, reason = verdict
    document = describe_reason(status, reason, Circumstances(job.photograph, job.mask, question, seconds))
    try:
        write_reason(job.folder, photograph, document, token)
    except (CloudfitError, OSError, ValueError) as error:
        return Outcome(job, "failed", f"{reason}; and {job.folder} cannot be written: {error}", details=details)
    return replace(outcome_from_document(job, document), details=details)


def _fit(
    job: Job,
    question: Question,
    source: StackSource,
    photograph: Photograph,
    clock: "_Clock",
    token: str,
    on_progress: Progress,
) -> Outcome:
    on_progress("finding clouds", 0.0)
    height, width = photograph.pixels.shape[:2]
    labels = None if job.mask is None else read_user_mask(job.mask, (height, width))
    analysis = source.stages.analyse(photograph, labels)
    clock.lap("analysis")
    stack = source.get(on_progress)
    clock.skip()
    fit = source.stages.fit(analysis, question.scene, stack, question.options, on_progress)
    clock.skip()
    on_progress("writing", 0.0)
    space = source.stages.space(analysis, stack, question.options)
    seconds = clock.laps(fit.seconds)
    if source.report is not None:
        seconds["stack"] = source.report.seconds
    document = describe_fit(fit, space, Circumstances(job.photograph, job.mask, question, seconds))
    write_fit(job.folder, fit, document, token)
    return outcome_from_document(job, document)


def _sentence(error: Exception) -> str:
    text = str(error).strip().splitlines()
    return f"{type(error).__name__}: {text[0]}" if text else type(error).__name__


class _Clock:
    """Seconds by stage."""

    def __init__(self) -> None:
        self._seconds: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, stage: str) -> None:
        """Book the time since the last call under a stage."""
        now = time.perf_counter()
        self._seconds[stage] = now - self._last
        self._last = now

    def skip(self) -> None:
        """Leave the time since the last call out: it is booked elsewhere."""
        self._last = time.perf_counter()

    def laps(self, others: dict[str, float] | None = None) -> dict[str, float]:
        """All stages, those booked elsewhere included, and their total."""
        stages = {**self._seconds, **(others or {})}
        return {**stages, "total": sum(stages.values())}
