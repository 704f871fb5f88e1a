"""Optimisers over the unit cube: one registry of ready-made methods; see `base` for what they have in common."""

from collections.abc import Mapping
from types import MappingProxyType

from cloudfit.optimisers.adam import Adam
from cloudfit.optimisers.ask_tell import AskTellMinimiser, AskTellOptimiser, run_ask_tell
from cloudfit.optimisers.base import (
    Budget,
    DifferentiableObjective,
    Minimiser,
    Objective,
    OptimiserResult,
    Progress,
    StopReason,
)
from cloudfit.optimisers.genetic import GeneticAlgorithm
from cloudfit.optimisers.gradient_descent import GradientMethod, GradientMinimiser
from cloudfit.optimisers.lbfgs import Lbfgs
from cloudfit.optimisers.many_starts import ManyStarts
from cloudfit.optimisers.nlopt_adapter import LOCAL, NEED_A_LOCAL, NLOPT_ALGORITHMS, NloptMinimiser
from cloudfit.optimisers.polished import Polished
from cloudfit.optimisers.screened_evolution import ScreenedEvolution
from cloudfit.optimisers.steepest_descent import SteepestDescent

GLOBAL_SEARCH = NloptMinimiser("crs2_lm", largest_evaluations=1250)
"""Controlled random search; 750 more evaluations of one search would gain at most 0.1 loss floors before the polishing."""

POLISHING = NloptMinimiser("sbplx", initial_step=0.05)
"""A local method that tolerates the small steps of a histogram loss, kept near the point that it starts from.

First steps of 0.02 or 0.15 and Nelder-Mead do as well, the latter better where the genetic algorithm has ended far from an optimum.
"""

SCREENED_ITERATIONS = 36
"""Some 730 evaluations. Three such searches find better optima than one of as many together: photographs have several basins.

Twelve iterations more gain little once all pixels have settled what was found, and take a quarter more time: on a photograph with two
basins the better one is found by three fits of six instead of two; 24 more find it as often.
"""

OPTIMISERS: Mapping[str, Minimiser] = MappingProxyType(
    {
        "genetic": AskTellMinimiser(GeneticAlgorithm()),
        "genetic_paper": AskTellMinimiser(GeneticAlgorithm.paper()),
        "genetic+sbplx": Polished(AskTellMinimiser(GeneticAlgorithm()), POLISHING),
        "crs2_lm+sbplx": Polished(GLOBAL_SEARCH, POLISHING),
        "screened_evolution": AskTellMinimiser(ScreenedEvolution(largest_iterations=SCREENED_ITERATIONS)),
        "screened_evolution+sbplx": Polished(
            AskTellMinimiser(ScreenedEvolution(largest_iterations=SCREENED_ITERATIONS)), POLISHING
        ),
        **{name: NloptMinimiser(name) for name in NLOPT_ALGORITHMS},
        **{f"{name}+{local}": NloptMinimiser(name, local) for name in NEED_A_LOCAL for local in ("bobyqa", "sbplx")},
        **{
            f"{local}_multistart": ManyStarts(NloptMinimiser(local, tolerance=1e-3, initial_step=0.1))
            for local in LOCAL
        },
        "steepest_descent": AskTellMinimiser(SteepestDescent()),
        "adam": GradientMinimiser(Adam()),
        "lbfgs": GradientMinimiser(Lbfgs()),
    }
)

DEFAULT_OPTIMISER = "screened_evolution"
"""The largest anytime area of all, over evaluations and over seconds.

`python -m benchmarks optimisers`, 12 problems, 15 seeds, 600 evaluations a run (benchmarks/results/optimisers.json). Excess over the
best loss that anyone found; seconds of the processor for one run:

| method | area, evaluations | area, seconds | median excess | runs within 1 % | seconds |
|---|---|---|---|---|---|
| `screened_evolution` | 0.294 | 0.291 | 13.6 % | 11 % | 0.3 |
| `direct` | 0.285 | 0.243 | 16.0 % | 0 % | 1.6 |
| `crs2_lm+sbplx` | 0.275 | 0.225 | 14.9 % | 3 % | 1.6 |
| `genetic` | 0.267 | 0.225 | 23.8 % | 0 % | 0.3 |
| pycma | 0.259 | 0.212 | 17.8 % | 1 % | 0.4 |
| scipy's differential evolution | 0.266 | 0.153 | 22.6 % | 0 % | 0.3 |

It evaluates whole generations, which costs a quarter of the time of single points. One search finds the best basin seldom, hence three.
"""

__all__ = [
    "DEFAULT_OPTIMISER",
    "OPTIMISERS",
    "Adam",
    "AskTellMinimiser",
    "AskTellOptimiser",
    "Budget",
    "DifferentiableObjective",
    "GeneticAlgorithm",
    "GradientMethod",
    "GradientMinimiser",
    "Lbfgs",
    "ManyStarts",
    "Minimiser",
    "NloptMinimiser",
    "Objective",
    "OptimiserResult",
    "Polished",
    "Progress",
    "ScreenedEvolution",
    "SteepestDescent",
    "StopReason",
    "run_ask_tell",
]
