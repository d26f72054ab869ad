"""The command line: one module a command, registered by one line each.

Nothing heavy is imported here or at the top of a command's module, so that help comes at once.
"""

import io
import signal
import sys
from typing import Annotated

import typer

import fibercontact
from fibercontact.cli import (
    check,
    corpus,
    explain,
    info,
    level1,
    new_scene,
    new_solver,
    reference,
    render,
    report,
    runs,
    simulate,
    solve,
    solvers,
    table,
    validate,
)

__all__ = ["app", "main"]

app = typer.Typer(
    name="fibercontact",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

app.command("table")(table.table)
app.add_typer(runs.runs, name="runs")
app.command("solve")(solve.solve)
app.command("explain")(explain.explain)
app.command("info")(info.info)
app.command("solvers")(solvers.solvers)
app.command("check")(check.check)
app.command("new-solver")(new_solver.new_solver)
app.command("simulate")(simulate.simulate)
app.command("new-scene")(new_scene.new_scene)
app.add_typer(corpus.corpus, name="corpus")
app.command("render")(render.render)
app.command("report")(report.report)
app.command("harvest")(level1.harvest)
app.command("reference")(reference.reference)
app.command("validate")(validate.validate)


def _version(asked: bool) -> None:
    if asked:
        typer.echo(f"fibercontact {fibercontact.__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Compare local solvers of frictional contact on problems from thin elastic rods.

    Start with `fibercontact table`, which regenerates the comparison table.

    `fibercontact COMMAND --help` explains a command.
    """


def main() -> None:
    """Entry point. Exit codes: 0 done, 1 not solved, 2 an error of one line on stderr, 130 interrupted."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C: what is done is kept
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a terminal that lacks a character gets its code
            stream.reconfigure(errors="backslashreplace")
    app()
