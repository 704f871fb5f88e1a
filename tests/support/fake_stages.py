"""Stand-ins for the steps of a fit, at once and obedient to the name of the photograph; workers can import them."""

import os
import signal
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

from cloudfit.analysis import PhotographAnalysis
from cloudfit.fit_types import FitOptions, PhotographFit
from cloudfit.one_photograph import Stages
from cloudfit.parameters import SearchSpace
from cloudfit.photograph import Photograph, read_photograph
from cloudfit.quality import Quality
from cloudfit.scene import Scene
from precompute.stack_store import StackReport
from render.errors import StoreError
from render.scattering_stack import ScatteringStack, ScatteringTables
from tests.support.hand_made_fit import make_analysis, make_fit, make_space, refuse_clouds

Progress = Callable[[str, float], None]


def read(path: Path) -> Photograph:
    """Read for real, and note that it was."""
    with (path.parent / "log.txt").open("a") as log:
        log.write(f"{path.stem} {os.getpid()} {torch.get_num_threads()}\n")
    return read_photograph(path)


def analyse(photograph: Photograph, labels: Tensor | None) -> PhotographAnalysis:
    """Do what the photograph's name says."""
    if photograph.path.stem.startswith("empty"):
        return refuse_clouds(photograph, labels)
    if photograph.path.stem.startswith("surprise"):
        raise ZeroDivisionError("one over nothing\nand more")
    if photograph.path.stem.startswith("deadly"):
        os.kill(os.getpid(), signal.SIGKILL)
    if photograph.path.stem.startswith("stop"):
        raise KeyboardInterrupt
    analysis = make_analysis(photograph)
    if labels is not None:
        analysis.mask.labels.copy_(labels)
    return analysis


def prepare_stack(
    scene: Scene,
    quality: Quality,
    seed: int,
    folder: Path | None,
    on_progress: Progress,
    optical_depths: tuple[float, float],
) -> tuple[ScatteringStack, StackReport]:
    """A stack of one pixel; each call leaves a line beside the tables."""
    assert folder is not None
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "calls.txt").open("a") as calls:
        calls.write(f"{os.getpid()}\n")
    on_progress("stack", 1.0)
    return ScatteringStack(one_pixel_tables()), StackReport(0.5, False, folder / "stack.safetensors")


def one_pixel_tables() -> ScatteringTables:
    """Tables with two nodes each."""
    return ScatteringTables(
        width=1,
        height=1,
        pixel=torch.zeros(1, dtype=torch.int64),
        optical_length=torch.full((1,), 20.0),
        cos_sun=torch.zeros(1),
        asymmetry=torch.tensor([0.0, 0.9]),
        extinction=torch.tensor([0.01, 1.0]),
        soft_extinction=torch.tensor(0.1),
        knots=torch.tensor([2, 3, 4]),
        single=torch.ones(2, 1),
        multiple=torch.ones(3, 2, 2, 1),
        tail_ratio=torch.zeros(2, 2),
        tail_share=torch.zeros(2, 2),
        standard_error=torch.zeros(3, 2, 2),
        image_error=torch.zeros(2, 2),
        bright_error=torch.zeros(2, 2),
        effective_share=torch.ones(3, 2, 2),
    )


def refuse_stack(*arguments: object) -> tuple[ScatteringStack, StackReport]:
    """A store without room."""
    raise StoreError("cannot save the tables: no space left on device")


def fit(
    analysis: PhotographAnalysis, scene: Scene, stack: ScatteringStack, options: FitOptions, on_progress: Progress
) -> PhotographFit:
    """Two answers at once; a photograph called half* is interrupted."""
    on_progress("search", 1.0)
    return make_fit(analysis, interrupted=analysis.photograph.path.stem.startswith("half"))


def space(analysis: PhotographAnalysis, stack: ScatteringStack, options: FitOptions) -> SearchSpace:
    """The ranges of the hand-made fit."""
    return make_space(options.ambient)


FAKE_STAGES = Stages(read, analyse, prepare_stack, fit, space)
