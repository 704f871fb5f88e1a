"""The problems of a comparison: a photograph and a scene each, described by what can be sent to another process and hashed."""

from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import torch
from torch import Tensor

from cloudfit import __version__
from cloudfit.analysis import PhotographAnalysis, analyse_photograph
from cloudfit.cloud_mask import read_user_mask
from cloudfit.comparison.synthetic import compose_analysis, draw_truth, true_point
from cloudfit.fit_problem import FitProblem, resize_image
from cloudfit.fit_types import FitOptions
from cloudfit.one_photograph import file_sha256
from cloudfit.optimisers.base import Objective
from cloudfit.photograph import read_photograph
from cloudfit.scene_record import scene_from_record
from cloudfit.stack import prepare_stack
from precompute.store import table_key
from render.cloud_image import blend_air
from render.scattering_stack import ScatteringStack

KEPT_STACKS, KEPT_PROBLEMS = 4, 16
"""Loaded at the same time by a process."""

WARM_UP = 20
"""Candidates evaluated before a problem is first timed: compiled loops and caches are no part of any method."""


Value = TypeVar("Value")


class Shelf(Generic[Value]):
    """The values that were asked for last, by key; the oldest goes first.

    Args:
        size: how many are kept.
    """

    def __init__(self, size: int) -> None:
        self._size, self._values = size, OrderedDict[str, Value]()

    def get(self, key: str, make: Callable[[], Value]) -> Value:
        """The value that is kept under the key, or a new one."""
        if key not in self._values:
            self._values[key] = make()
        self._values.move_to_end(key)
        while len(self._values) > self._size:
            self._values.popitem(last=False)
        return self._values[key]


@dataclass(frozen=True, eq=False)
class Problem:
    """A problem ready to be searched.

    Args:
        name: unique in a comparison.
        fit: the objective and the space.
        truth: point of the unit cube that the photograph was made with `(parameter,)`, or None.
    """

    name: str
    fit: FitProblem
    truth: Tensor | None = None

    @property
    def dimension(self) -> int:
        """Number of searched parameters."""
        return self.fit.space.dimension

    @property
    def objective(self) -> Objective:
        """Losses of a population in the unit cube, with gradients where the loss has them."""
        return self.fit

    def loss(self, unit: Tensor) -> float:
        """Loss of one point `(parameter,)`, computed by itself."""
        return float(self.fit.evaluate(unit[None])[0])

    def facts(self) -> dict[str, Any]:
        """What statistics and pages need to know, as JSON."""
        return {
            "name": self.name,
            "dimension": self.dimension,
            "floor": self.fit.floor,
            "pixels": len(self.fit.counted),
            "truth": None if self.truth is None else self.truth.tolist(),
            "truth_loss": None if self.truth is None else self.loss(self.truth),
            "warnings": list(self.fit.analysis.warnings),
        }

    @torch.no_grad()
    def picture(self, unit: Tensor) -> Tensor:
        """Image `(height, width, channel)` of a point `(parameter,)`, composed from the stack at the size of its tables."""
        fit, tables = self.fit, self.fit.stack.tables
        cloud = fit.compose(fit.space.to_physical(unit[None].to(torch.float32)))
        seen = blend_air(cloud, fit.sky, _best_air(fit, cloud).to(torch.float32))[0]
        image = _resized_sky(fit).flatten(0, 1).clone()
        image[fit.stack.pixel[fit.counted]] = seen.T.to(image.dtype)
        return image.unflatten(0, (tables.height, tables.width))


def _best_air(fit: FitProblem, cloud: Tensor) -> Tensor:
    """Optical depth of the air with which clouds `(population, channel, pixel)` come closest `(population, channel)`."""
    return fit.comparison.find_air(cloud, fit.sky, fit.air_refinements, fit.coarse_air).air_depth


def _resized_sky(fit: FitProblem) -> Tensor:
    return resize_image(fit.analysis.sky, fit.stack.tables.width, fit.stack.tables.height)


_stacks: Shelf[ScatteringStack] = Shelf(KEPT_STACKS)
_problems: Shelf[Problem] = Shelf(KEPT_PROBLEMS)


class ProblemSource(Protocol):
    """Describes a problem with plain values, so that it can be sent to a process that loads it, and hashed."""

    @property
    def name(self) -> str:
        """Unique in a comparison; also the name of its folder."""
        ...

    def fingerprint(self) -> str:
        """Hash of everything that a run on it depends on."""
        ...

    def load(self) -> Problem:
        """The problem."""
        ...


@dataclass(frozen=True)
class SceneSource:
    """A scene with its stack.

    Args:
        record: as `describe_scene` makes it.
        options: quality and seed of the stack; display curve, ambient light and air of the objective.
        tables: folder of the stack files.
    """

    record: Mapping[str, Any] = field(hash=False)
    options: FitOptions
    tables: Path

    def stack(self) -> ScatteringStack:
        """The stack, loaded or built; the last few are kept."""

        def load() -> ScatteringStack:
            self.tables.mkdir(parents=True, exist_ok=True)
            scene = scene_from_record(self.record)
            options = self.options
            stack, _ = prepare_stack(
                scene, options.quality, options.seed, self.tables, optical_depths=options.optical_depths
            )
            return stack

        return _stacks.get(table_key({**self.dependencies(), "tables": str(self.tables)}), load)

    def problem(self, analysis: PhotographAnalysis) -> FitProblem:
        """The objective of a photograph: the only place here that knows how the options enter it."""
        options = self.options
        return FitProblem(
            analysis,
            self.stack(),
            options.ambient,
            options.transfer,
            options.air_refinements,
            options.loss,
            options.coarse_air,
        )

    def dependencies(self) -> dict[str, Any]:
        """What the objective depends on, beside the photograph."""
        scene = {**self.record, "volume": {"sha256": self.record["volume"]["sha256"]}}
        return {"version": __version__, "scene": scene, "options": repr(self.options)}


def load_problem(source: ProblemSource) -> Problem:
    """The problem, warmed up; the last few are kept."""

    def load() -> Problem:
        problem = source.load()
        middle = torch.full((WARM_UP, problem.dimension), 0.5)
        problem.objective(middle)
        problem.objective(middle[:1])
        return problem

    return _problems.get(f"{source.name} {source.fingerprint()}", load)


@dataclass(frozen=True)
class PhotographSource:
    """A photograph file in a scene.

    Args:
        name: of the problem.
        photograph: the file.
        mask: of the user, or None.
        scene: volume, camera, sun and options.
        truth: parameters in units, by name, that a synthetic photograph was made with, or None.
    """

    name: str
    photograph: Path
    mask: Path | None
    scene: SceneSource
    truth: Mapping[str, float] | None = field(default=None, hash=False)

    def fingerprint(self) -> str:
        """Hash of the bytes of the files, the scene and the options."""
        files = {"photograph": file_sha256(self.photograph), "mask": file_sha256(self.mask)}
        return table_key({"kind": "photograph", **files, **self.scene.dependencies()})

    def load(self) -> Problem:
        """The problem. Raises PhotographError where the photograph cannot be fitted."""
        photograph = read_photograph(self.photograph)
        height, width = photograph.pixels.shape[:2]
        labels = None if self.mask is None else read_user_mask(self.mask, (height, width))
        fit = self.scene.problem(analyse_photograph(photograph, labels))
        return Problem(self.name, fit, None if self.truth is None else true_point(fit.space, self.truth))


@dataclass(frozen=True)
class ComposedSource:
    """A photograph composed from the stack itself at a random point: its best loss is known to be close to zero.

    That flatters no method more than another, but it says nothing about real photographs.

    Args:
        name: of the problem.
        seed: of the point.
        scene: volume, camera, sun and options.
    """

    name: str
    seed: int
    scene: SceneSource

    def fingerprint(self) -> str:
        """Hash of the seed, the scene and the options."""
        return table_key({"kind": "composed", "seed": self.seed, **self.scene.dependencies()})

    def load(self) -> Problem:
        """The problem, with its truth."""
        stack = self.scene.stack()
        truth = draw_truth(stack, torch.Generator().manual_seed(self.seed))
        fit = self.scene.problem(compose_analysis(stack, truth))
        return Problem(self.name, fit, true_point(fit.space, truth.parameters))
