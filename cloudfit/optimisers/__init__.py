"""Optimisers over the unit cube: one registry of ready-made methods; see `base` for what they have in common."""

from collections.abc import Mapping
from types import MappingProxyType

from cloudfit.optimisers.base import (
    AskTellMinimiser,
    AskTellOptimiser,
    Budget,
    Minimiser,
    Objective,
    OptimiserResult,
    Progress,
    StopReason,
    run_ask_tell,
)
from cloudfit.optimisers.genetic import GeneticAlgorithm
from cloudfit.optimisers.nlopt_adapter import NLOPT_ALGORITHMS, NloptMinimiser
from cloudfit.optimisers.polished import Polished

POLISHING = NloptMinimiser("sbplx", initial_step=0.05)
"""The local method that tolerates the small steps of a histogram loss best, kept near the point that it starts from."""

OPTIMISERS: Mapping[str, Minimiser] = MappingProxyType(
    {
        "genetic": AskTellMinimiser(GeneticAlgorithm()),
        "genetic_paper": AskTellMinimiser(GeneticAlgorithm.paper()),
        "genetic+sbplx": Polished(AskTellMinimiser(GeneticAlgorithm()), POLISHING),
        "crs2_lm+sbplx": Polished(NloptMinimiser("crs2_lm"), POLISHING),
        **{name: NloptMinimiser(name) for name in NLOPT_ALGORITHMS},
    }
)

__all__ = [
    "OPTIMISERS",
    "AskTellMinimiser",
    "AskTellOptimiser",
    "Budget",
    "GeneticAlgorithm",
    "Minimiser",
    "NloptMinimiser",
    "Objective",
    "OptimiserResult",
    "Polished",
    "Progress",
    "StopReason",
    "run_ask_tell",
]
