"""Optimisers of other libraries behind our protocol: pycma, and scipy's differential evolution (extra `bench`)."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import cma
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import differential_evolution
from torch import Tensor

from cloudfit.optimisers.base import (
    Budget,
    EvaluationLog,
    Minimiser,
    Objective,
    OptimiserResult,
    Progress,
    StopReason,
    check_start,
    run_logged,
    seeded_generator,
)
from render.errors import ParameterError

TOLERANCE = 1e-4
"""Step in the unit cube below which a search has converged, as for our own methods: the histograms jump on smaller scales."""


@dataclass(frozen=True)
class PycmaMinimiser:
    """CMA-ES of pycma in the unit cube (Hansen, "The CMA evolution strategy: a tutorial", 2016); whole generations at once.

    With a growth above one it restarts itself with a population that much larger each time, IPOP-CMA-ES (Auger and Hansen 2005).

    Args:
        initial_step: sigma_0; pycma advises a third of the range.
        growth: factor of the population at a restart; 1 for no restart of its own.

    Raises:
        ParameterError: when a number is outside its domain.
    """

    initial_step: float = 0.3
    growth: float = 1.0

    def __post_init__(self) -> None:
        if not (self.initial_step > 0.0 and self.growth >= 1.0):
            raise ParameterError(
                f"expected initial_step > 0 and growth of 1 or more, got {self.initial_step} and {self.growth}"
            )

    def minimise(
        self,
        objective: Objective,
        dimension: int,
        budget: Budget,
        seed: int,
        on_progress: Progress | None = None,
        start: Tensor | None = None,
    ) -> OptimiserResult:
        """Search the unit cube; see `Minimiser`. Without a start, one is drawn at random."""
        if dimension < 2:
            raise ParameterError("pycma searches two parameters or more")
        generator = seeded_generator(seed)
        first = check_start(start, dimension)

        def search(log: EvaluationLog) -> StopReason:
            point, size = first, 4 + int(3 * np.log(dimension))
            for restart in range(1_000_000):
                if point is None:
                    point = torch.rand(dimension, generator=generator, dtype=torch.float64)
                self._descend(log, point.numpy(), size, seed + 1 + restart)
                if self.growth == 1.0:
                    break
                point, size = None, round(self.growth * size)
            return StopReason.CONVERGED

        return run_logged(search, objective, dimension, budget, on_progress)

    def _descend(self, log: EvaluationLog, start: NDArray[np.float64], size: int, seed: int) -> None:
        """One run of CMA-ES until it converges."""
        options = {
            "bounds": [0.0, 1.0],
            "popsize": size,
            "seed": seed,
            "tolx": TOLERANCE,
            "verbose": -10,
            "verb_disp": 0,
        }
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of pycma, about plateaus and bounds
            strategy = cma.CMAEvolutionStrategy(start, self.initial_step, options)
            while not strategy.stop():
                points = strategy.ask()
                strategy.tell(points, log.evaluate(torch.from_numpy(np.array(points))).tolist())


@dataclass(frozen=True)
class ScipyDifferentialEvolution:
    """`scipy.optimize.differential_evolution` (Storn and Price 1997) with its own defaults, but without the polish.

    The polish is a quasi-Newton method on finite differences, which a loss of histograms, constant on small scales, leads nowhere.

    Args:
        generations: whether a generation is evaluated at once (`updating="deferred"`), instead of point by point, each of which
            may already use the one before (`"immediate"`, scipy's default).
    """

    generations: bool = False

    def minimise(
        self,
        objective: Objective,
        dimension: int,
        budget: Budget,
        seed: int,
        on_progress: Progress | None = None,
        start: Tensor | None = None,
    ) -> OptimiserResult:
        """Search the unit cube; see `Minimiser`."""
        generator = np.random.default_rng(seeded_generator(seed).initial_seed())
        point = check_start(start, dimension)

        def search(log: EvaluationLog) -> StopReason:
            def one(x: NDArray[np.float64]) -> float:
                return float(log.evaluate(torch.from_numpy(x.copy())[None])[0])

            def many(x: NDArray[np.float64]) -> NDArray[np.float64]:
                return log.evaluate(torch.from_numpy(x.T.copy())).numpy()

            differential_evolution(
                many if self.generations else one,
                [(0.0, 1.0)] * dimension,
                maxiter=1_000_000,
                rng=generator,
                polish=False,
                updating="deferred" if self.generations else "immediate",
                vectorized=self.generations,
                x0=None if point is None else point.numpy(),
            )
            return StopReason.CONVERGED

        return run_logged(search, objective, dimension, budget, on_progress)


PEERS: Mapping[str, Minimiser] = MappingProxyType(
    {
        "pycma": PycmaMinimiser(),
        "pycma_ipop": PycmaMinimiser(growth=2.0),
        "scipy_de": ScipyDifferentialEvolution(),
        "scipy_de_generations": ScipyDifferentialEvolution(generations=True),
    }
)
"""Peers by name."""
