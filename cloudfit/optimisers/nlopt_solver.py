"""The methods of NLopt as one function, in this process or in one of its own; the only file that knows nlopt.

Run as a program, it solves what its argument describes for whoever started it: it writes each point to its standard output and
reads the loss from its standard input. It imports neither torch nor the rest of the package, so that it starts at once.
"""

import contextlib
import json
import os
import signal
import struct
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import BinaryIO

import nlopt
import numpy as np
from numpy.typing import NDArray

ALGORITHMS: Mapping[str, int] = MappingProxyType(
    {
        "crs2_lm": nlopt.GN_CRS2_LM,
        "direct": nlopt.GN_DIRECT,
        "direct_l": nlopt.GN_DIRECT_L,
        "orig_direct_l": nlopt.GN_ORIG_DIRECT_L,
        "isres": nlopt.GN_ISRES,
        "esch": nlopt.GN_ESCH,
        "ags": nlopt.GN_AGS,
        "mlsl": nlopt.G_MLSL,
        "mlsl_lds": nlopt.G_MLSL_LDS,
        "sbplx": nlopt.LN_SBPLX,
        "bobyqa": nlopt.LN_BOBYQA,
        "cobyla": nlopt.LN_COBYLA,
        "nelder_mead": nlopt.LN_NELDERMEAD,
    }
)

NEVER_AGAIN = 1e9
"""Answer to questions that are asked after the end."""

Evaluate = Callable[[NDArray[np.float64]], float | None]
"""A point of the unit cube (parameter,) -> its finite loss, or None to end the search."""


@dataclass(frozen=True)
class Search:
    """What NLopt is asked to do.

    Args:
        algorithm: one of `ALGORITHMS`.
        local: the method inside of MLSL, one of `ALGORITHMS`.
        start: first point in the unit cube.
        tolerance: step in every parameter below which a method has converged.
        local_tolerance: the same for the method inside.
        initial_step: first step of local methods.
        evaluations: a limit, because some methods never stop.
        seed: of NLopt's stream of random numbers.
    """

    algorithm: str
    local: str | None
    start: tuple[float, ...]
    tolerance: float
    local_tolerance: float
    initial_step: float
    evaluations: int
    seed: int


def solve(search: Search, evaluate: Evaluate) -> None:
    """Run the search in this process until it converges or `evaluate` ends it."""
    dimension = len(search.start)
    solver = nlopt.opt(ALGORITHMS[search.algorithm], dimension)
    if search.local is not None:
        inner = nlopt.opt(ALGORITHMS[search.local], dimension)
        inner.set_xtol_abs(search.local_tolerance)
        inner.set_initial_step(search.initial_step)
        solver.set_local_optimizer(inner)
    solver.set_lower_bounds(np.zeros(dimension))
    solver.set_upper_bounds(np.ones(dimension))
    solver.set_xtol_abs(search.tolerance)
    solver.set_initial_step(search.initial_step)
    solver.set_maxeval(search.evaluations)
    ended = False

    def answer(x: NDArray[np.float64], gradient: NDArray[np.float64]) -> float:
        nonlocal ended
        # The buffer of x is NLopt's and will be used again.
        loss = None if ended else evaluate(x.copy())
        if loss is None:
            ended = True
            solver.force_stop()
            return NEVER_AGAIN
        return loss

    solver.set_min_objective(answer)
    nlopt.srand(search.seed)
    # Roundoff limits the steps of a local method: as converged as it can be.
    with contextlib.suppress(nlopt.ForcedStop, nlopt.RoundoffLimited):
        solver.optimize(np.array(search.start))


def solve_apart(search: Search, evaluate: Evaluate) -> None:
    """Run the search in a process of its own, whose crash is an error here; the losses are computed here as ever.

    Raises:
        RuntimeError: when that process ends otherwise than it should.
    """
    size = 8 * len(search.start)
    command = [sys.executable, "-P", __file__, json.dumps(asdict(search))]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            while len(point := process.stdout.read(size)) == size:
                loss = evaluate(np.frombuffer(point))
                if loss is None:
                    return
                # A process that has ended meanwhile is noticed by what it does not answer; past the buffer, which would keep the loss.
                with contextlib.suppress(BrokenPipeError):
                    os.write(process.stdin.fileno(), struct.pack("d", loss))
            if process.wait() != 0:
                raise RuntimeError(f"{search.algorithm} {_describe_end(process.returncode)}")
        finally:
            process.kill()


def _describe_end(code: int) -> str:
    if code < 0:
        return f"crashed with {signal.Signals(-code).name}"
    return f"gave up with exit code {code}"


def serve(search: Search, questions: BinaryIO, answers: BinaryIO) -> None:
    """Solve for the process at the other end of the pipes, until it closes them."""

    def ask(x: NDArray[np.float64]) -> float | None:
        questions.write(x.tobytes())
        questions.flush()
        answer = answers.read(8)
        return float(struct.unpack("d", answer)[0]) if len(answer) == 8 else None

    solve(search, ask)


def main() -> None:
    """Serve the process that has started this one."""
    # Who interrupts the run decides what becomes of it there, not here.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # NLopt's own messages must not get between the points.
    questions = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    settings = json.loads(sys.argv[1])
    with questions:
        serve(Search(**{**settings, "start": tuple(settings["start"])}), questions, sys.stdin.buffer)


if __name__ == "__main__":
    main()
