"""What Mitsuba would need for the table of a stack, from a few nodes and the law that noise falls with the root of the work."""

import argparse
import math
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass

import torch
from torch import Tensor

from benchmarks.common import Outcome, make_table, scene_with, tell_progress
from benchmarks.mitsuba_peer import PeerCost, find_mitsuba, measure_peer
from benchmarks.parameter_sets import DEPTH, Disagreement, ParameterSet
from benchmarks.stack_build import BuildCost, BuildTask, PeerTask, build_and_compare
from render.procedural_cloud import build_cumulus

NODES = (
    ParameterSet(0.475, 0.5, 1.0),
    ParameterSet(0.0, 6.0, 1.0),
    ParameterSet(0.475, 30.0, 1.0),
    ParameterSet(0.8, 60.0, 1.0),
)
"""At which Mitsuba is measured; each node of the table is charged like the nearest of these in optical depth."""


@dataclass(frozen=True)
class Charge:
    """What one measured node stands for.

    Args:
        peer: measured.
        nodes: of the table that it stands for.
        stack_error: at this node.
        at_stack_error, at_tolerance: seconds that Mitsuba needs for one image with that error.
    """

    peer: PeerCost
    nodes: int
    stack_error: float
    at_stack_error: float
    at_tolerance: float


def compare_peers(arguments: argparse.Namespace, base: BuildTask, pool: Executor) -> Outcome:
    """Build the stack, measure its errors at the nodes, and Mitsuba at the same nodes."""
    mi = find_mitsuba(arguments.threads)
    if mi is None:
        return Outcome({"skipped": True}, (), ("peers: skipped, Mitsuba is not installed (pip install mitsuba)",))
    task = PeerTask(base, NODES, arguments.pixels, arguments.traced)
    cost, disagreements = pool.submit(build_and_compare, task).result()
    tell_progress(f"stack: {cost.seconds:.1f} s; errors {', '.join(f'{one.error:.2%}' for one in disagreements)}")
    scene = scene_with(build_cumulus(base.side), None, base.width, base.height)
    notes = [*NOTES, _describe_stack(cost, disagreements)]
    charges: dict[str, list[Charge]] = {}
    counts = nodes_by_depth(base.quality.place_depths(*DEPTH), base.quality.asymmetry_nodes)
    for variant in arguments.variants:
        try:
            peers = [
                measure_peer(mi, variant, scene, node, base.quality.table_effort.orders, arguments.samples)
                for node in NODES
            ]
        except RuntimeError as error:
            notes.append(f"{variant}: skipped, {str(error).strip().splitlines()[0]}")
            continue
        tolerance = base.quality.table_effort.tolerance or math.inf
        charges[variant] = [
            Charge(peer, count, one.at_least, peer.seconds_for(one.at_least), peer.seconds_for(tolerance))
            for peer, one, count in zip(peers, disagreements, counts, strict=True)
        ]
        tell_progress(f"{variant}: {', '.join(f'{peer.seconds:.1f} s at {peer.error:.1%}' for peer in peers)}")
        notes += _arithmetic(variant, charges[variant], cost, tolerance)
    columns = (
        "variant",
        "node (g, depth)",
        "samples",
        "first, s",
        "seconds",
        "error",
        "stack's",
        "s for stack's",
        "s for tolerance",
        "nodes",
    )
    rows = [_row(charge) for variant in charges.values() for charge in variant]
    values = {
        "stack": asdict(cost),
        "stack_errors": [asdict(one) for one in disagreements],
        "charges": {variant: [asdict(charge) for charge in found] for variant, found in charges.items()},
        "totals": {variant: dict(zip(TOTALS, totals(found), strict=True)) for variant, found in charges.items()},
        "version": mi.__version__,
    }
    return Outcome(
        values, (make_table(f"Mitsuba {mi.__version__}, volpath", columns, rows),) if rows else (), tuple(notes)
    )


TOTALS = ("at_stack_error_seconds", "at_tolerance_seconds")

NOTES = (
    "peers: error is the relative RMS noise over the cloud pixels, for Mitsuba from the difference of two images, for the stack against "
    "the path tracer, though never less than a quarter of the path tracer's own noise; Mitsuba's depth is the stack's largest order "
    "plus one, its Russian roulette as it is by default, all threads the same",
    "where light is scattered strongly forward, a few bright pixels make most of the noise, and two images tell it to within a factor of "
    "two or so: compare the variants, which share their physics",
    "seconds for an error are seconds x (error / that error)^2; each node of the table counts as the measured one nearest in log depth",
    "one image of Mitsuba has one albedo, that of the stack any; this is not counted. A denoiser, which Mitsuba leaves to others, would "
    "help it, as smoothing helps the stack. Gradients, other lights and surfaces, which Mitsuba has, the stack has not",
)


def nodes_by_depth(depths: Tensor, asymmetries: int) -> list[int]:
    """How many nodes of the table each of the `NODES` stands for: those nearest in the logarithm of the optical depth."""
    measured = torch.tensor([node.optical_depth for node in NODES], dtype=torch.float64)
    nearest = (depths.log()[:, None] - measured.log()).abs().argmin(1)
    return [asymmetries * int((nearest == number).sum()) for number in range(len(NODES))]


def totals(charges: Sequence[Charge]) -> tuple[float, float]:
    """Seconds for the whole table: each node at the stack's error, and at the tolerance."""
    return (
        sum(charge.nodes * charge.at_stack_error for charge in charges),
        sum(charge.nodes * charge.at_tolerance for charge in charges),
    )


def _describe_stack(cost: BuildCost, disagreements: list[Disagreement]) -> str:
    errors = ", ".join(
        f"{one.error:.2%} at ({node.asymmetry:g}, {node.optical_depth:g}) with a path tracer's noise of {one.noise:.2%}"
        for node, one in zip(NODES, disagreements, strict=True)
    )
    return f"the stack took {cost.seconds:.1f} s; its errors are {errors}"


def _arithmetic(variant: str, charges: list[Charge], cost: BuildCost, tolerance: float) -> list[str]:
    own, accepted = totals(charges)
    nodes = sum(charge.nodes for charge in charges)
    terms = " + ".join(
        f"{charge.nodes} x {charge.peer.seconds:.3g} s x ({charge.peer.error:.3g} / {charge.stack_error:.3g})^2"
        for charge in charges
    )
    generous = " + ".join(
        f"{charge.nodes} x {charge.peer.seconds:.3g} s x ({charge.peer.error:.3g} / {tolerance:.3g})^2"
        for charge in charges
    )
    return [
        f"{variant}, {nodes} nodes at the stack's own errors: {terms} = {own:.3g} s, {own / cost.seconds:.3g} times the stack's",
        f"{variant}, {nodes} nodes at the tolerance: {generous} = {accepted:.3g} s, {accepted / cost.seconds:.3g} times the stack's",
    ]


def _row(charge: Charge) -> tuple[object, ...]:
    peer = charge.peer
    return (
        peer.variant,
        f"({peer.node.asymmetry:g}, {peer.node.optical_depth:g})",
        peer.samples,
        peer.first_seconds,
        peer.seconds,
        f"{peer.error:.2%}",
        f"{charge.stack_error:.2%}",
        charge.at_stack_error,
        charge.at_tolerance,
        charge.nodes,
    )
