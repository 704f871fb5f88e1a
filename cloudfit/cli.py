"""The program `cloudfit`."""

from typing import Annotated

import typer

from cloudfit import __version__
from cloudfit.commands import compare, demo, fit, fog, info, precompute, render, shafts, sky
from cloudfit.commands.console import EXIT_CODES

app = typer.Typer(
    name="cloudfit",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=f"Start with: cloudfit demo. {EXIT_CODES}",
)

app.command(epilog=fit.EPILOG)(fit.fit)
app.command(epilog=precompute.EPILOG)(precompute.precompute)
app.command(epilog=render.EPILOG)(render.render)
app.command(epilog=fog.EPILOG)(fog.fog)
app.command(epilog=sky.EPILOG)(sky.sky)
app.command(epilog=shafts.EPILOG)(shafts.shafts)
app.command(epilog=compare.EPILOG)(compare.compare)
app.command(epilog=info.EPILOG)(info.info)
app.command(epilog=demo.EPILOG)(demo.demo)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"cloudfit {__version__}")
        raise typer.Exit


@app.callback()
def describe(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and leave.")
    ] = False,
) -> None:
    """Fit the rendering parameters of a cloud volume to photographs of real clouds."""


def main() -> None:
    """Run the program; the exit code tells how it went."""
    app()
