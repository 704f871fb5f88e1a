"""What the commands say: results on stdout, messages and progress bars on stderr, errors as one sentence."""

import contextlib
import json
import logging
import os
import sys
from collections.abc import Callable, Iterator
from typing import Any, NoReturn

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from render.errors import CloudfitError

ALL_DONE, SOME_FAILED, USAGE, BAD_INPUT, INTERRUPTED = 0, 1, 2, 3, 130
"""Exit codes."""

EXIT_CODES = (
    "Exit codes: 0 all done (a photograph without clouds is done: it is reported as such), 1 some photographs failed, "
    "2 wrong usage, 3 bad input, 130 interrupted."
)

REFRESH_PER_SECOND = 5


class Speaker:
    """Says things to the user.

    Args:
        quiet: nothing but errors.
        verbose: tracebacks of unexpected errors too.
    """

    def __init__(self, quiet: bool = False, verbose: bool = False) -> None:
        self.quiet, self.verbose = quiet, verbose
        self._errors = Console(stderr=True, highlight=False, soft_wrap=True)
        logger = logging.getLogger("cloudfit")
        logger.handlers = [_Listener(self)]
        logger.setLevel(logging.INFO)

    def say(self, message: str) -> None:
        """A message on stderr, unless quiet."""
        if not self.quiet:
            self._errors.print(escape(message))

    def warn(self, message: str) -> None:
        """An error on stderr, quiet or not."""
        self._errors.print(f"[bold red]error:[/] {escape(message)}")

    @contextlib.contextmanager
    def progress(self, total: int | None = None, what: str = "photographs") -> Iterator["Bars"]:
        """Progress bars on stderr, one of them for the total of what is counted; none where there is no terminal."""
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.percentage:>3.0f} %"),
            TimeElapsedColumn(),
        )
        hidden = self.quiet or not self._errors.is_terminal
        with Progress(
            *columns, console=self._errors, transient=True, disable=hidden, refresh_per_second=REFRESH_PER_SECOND
        ) as progress:
            yield Bars(progress, total, what)


class _Listener(logging.Handler):
    """Says what the library logs."""

    def __init__(self, speaker: Speaker) -> None:
        super().__init__()
        self._speaker = speaker

    def emit(self, record: logging.LogRecord) -> None:
        self._speaker.say(record.getMessage())


class Bars:
    """A bar for the stage at hand, and one for the whole where a total is known."""

    def __init__(self, progress: Progress, total: int | None, what: str) -> None:
        self._progress = progress
        self._whole: TaskID | None = None if total is None else progress.add_task(what, total=total)
        self._stage = progress.add_task("", total=1.0, visible=False)

    def stage(self, stage: str, share: float) -> None:
        """Show the share of a stage that is done."""
        self._progress.update(self._stage, description=escape(stage), completed=share, visible=True)

    def finished(self, count: int = 1) -> None:
        """So many more of the whole."""
        self._progress.update(self._stage, visible=False)
        if self._whole is not None:
            self._progress.advance(self._whole, count)


@contextlib.contextmanager
def reported_errors(speaker: Speaker, resume_hint: str = "") -> Iterator[None]:
    """Turn errors of ours, of the file system and Ctrl-C into one sentence and an exit code."""
    try:
        yield
    except CloudfitError as error:
        _stop(speaker, str(error), BAD_INPUT)
    except BrokenPipeError:
        # Whoever read our output has enough of it; Python would complain once more while closing stdout.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise typer.Exit(ALL_DONE) from None
    except OSError as error:
        place = f"{error.filename}: " if error.filename else ""
        _stop(speaker, f"{place}{error.strerror or error}", BAD_INPUT)
    except KeyboardInterrupt:
        speaker.say(f"interrupted{'; ' + resume_hint if resume_hint else ''}")
        raise typer.Exit(INTERRUPTED) from None


def print_json(document: Any) -> None:
    """One JSON document on stdout."""
    print(json.dumps(document, indent=2, allow_nan=False, ensure_ascii=False))


def print_table(headings: list[str], rows: list[list[str]], left: int = 1) -> None:
    """A table on stdout; the first `left` columns are words, the others numbers. A pipe gets it unwrapped and plain."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    for number, heading in enumerate(headings):
        table.add_column(heading, justify="left" if number < left else "right", overflow="fold")
    for row in rows:
        table.add_row(*map(escape, row))
    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=10_000)
    console.print(table)


def show(value: float | None, form: str) -> str:
    """A number, or a dash where there is none."""
    return "-" if value is None else format(value, form)


Report = Callable[[str, float], None]


def _stop(speaker: Speaker, message: str, code: int) -> NoReturn:
    speaker.warn(message)
    raise typer.Exit(code) from None
