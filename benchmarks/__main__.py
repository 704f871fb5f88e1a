"""`python -m benchmarks NAME [--quick] [--json FILE]`: runs one benchmark; without a name, says which there are."""

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

from benchmarks import (
    accuracy,
    atmosphere,
    evaluation,
    fog,
    masks,
    optimisers,
    paper_experiment,
    photographs,
    promises,
    recovery,
    shafts,
    stack,
    stack_cost,
    tradeoff,
)
from benchmarks.common import Benchmark, first_line, publish
from render.errors import CloudfitError

BENCHMARKS: Mapping[str, Benchmark] = MappingProxyType(
    {
        module.__name__.rpartition(".")[2]: Benchmark(first_line(module.__doc__), module.add_arguments, module.run)
        for module in (
            stack_cost,
            evaluation,
            stack,
            accuracy,
            tradeoff,
            recovery,
            promises,
            masks,
            photographs,
            optimisers,
            paper_experiment,
            fog,
            atmosphere,
            shafts,
        )
    }
)


def build_parser() -> argparse.ArgumentParser:
    """The command line: one subcommand for each benchmark."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="Benchmarks of cloudfit.")
    subparsers = parser.add_subparsers(dest="name", metavar="NAME", required=True)
    for name, benchmark in BENCHMARKS.items():
        subparser = subparsers.add_parser(name, help=benchmark.question, description=benchmark.question)
        subparser.add_argument("--quick", action="store_true", help="a small version that shows that it runs")
        subparser.add_argument("--json", type=Path, metavar="FILE", help="write everything measured to this file")
        benchmark.add_arguments(subparser)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark that the command line names; returns the exit code."""
    parsed = build_parser().parse_args(arguments)
    benchmark = BENCHMARKS[parsed.name]
    try:
        outcome = benchmark.run(parsed)
    except CloudfitError as error:
        print(f"error: {error}", file=sys.stderr)
        return 3
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    publish(parsed.name, benchmark.question, parsed.quick, outcome, parsed.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
