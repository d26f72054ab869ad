"""`fibercontact runs`: what runs there are, what is in one, two beside each other, several made into one."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fibercontact.cli.errors import user_errors
from fibercontact.cli.screen import print_notes, print_table, screen

if TYPE_CHECKING:
    import pandas as pd


__all__ = ["runs"]

runs = typer.Typer(no_args_is_help=True, help="List, show, compare and merge runs of `fibercontact table`.")

Run = Annotated[Path, typer.Argument(metavar="RUN", help="A run's folder.")]

WORST = 20
"""Regressions of single problems that are printed; `--csv` has all pairs."""


@runs.command("list")
def list_runs(
    folder: Annotated[Path, typer.Argument(help="Runs in it, at any depth, are listed.")] = Path("runs"),
) -> None:
    """List runs: when and where they were measured, of what, and how much of what was asked is there.

    Exit codes: 0 listed, 2 no runs there.

    Example: fibercontact runs list
    """
    with user_errors():
        from fibercontact.bench.record import find_runs
        from fibercontact.bench.run_views import listing

        print_table(screen(), f"runs in {folder}", listing(find_runs(folder), folder))


@runs.command("show")
def show(run: Run) -> None:
    """Show a run: its protocol, the machine and versions, how far it is, and its table.

    Exit codes: 0 shown, 2 no run there.

    Example: fibercontact runs show runs/core306
    """
    with user_errors():
        from fibercontact.bench.record import read_run
        from fibercontact.bench.report import display, make_report
        from fibercontact.bench.run_views import sheet

        record, console = read_run(run), screen()
        print_table(console, str(run), sheet(record))
        if record.rows:
            for view in make_report(record.rows, record.values("solver")).views:
                print_table(console, view.title, display(view).reset_index(), texts=("solver", "reasons"))
                print_notes(console, view.notes)


@runs.command("compare")
def compare(
    a: Annotated[Path, typer.Argument(metavar="A", help="A run's folder: before.")],
    b: Annotated[Path, typer.Argument(metavar="B", help="Another one: now.")],
    margin: Annotated[
        float, typer.Option(help="A solver is slower when its interval is above 1 + MARGIN.", min=0.0)
    ] = 0.05,
    problem_margin: Annotated[float, typer.Option(help="The same for one problem.", min=0.0)] = 0.25,
    csv: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the pairs, problem by problem.")
    ] = None,
) -> None:
    """Compare run B with run A, problem by problem: ratios B/A of times and sweeps, and who fails now.

    Ratios are over the problems that a solver solved in both, with 95 % bootstrap intervals. Regressions are named:
    what A solved and B did not; a solver whose whole interval is above 1 + MARGIN; a problem whose own is above
    1 + PROBLEM-MARGIN.

    Exit codes: 0 no regression, 1 regressions, 2 an error, different protocols for instance.

    For example:

    fibercontact runs compare results/core306 runs/core306

    fibercontact runs compare runs/before runs/now --margin 0.02 --csv pairs.csv
    """
    with user_errors():
        from fibercontact.bench.compare import Margins
        from fibercontact.bench.compare import compare as compared
        from fibercontact.bench.record import read_run
        from fibercontact.files import replace_file

        found = compared(read_run(a), read_run(b), Margins(margin, problem_margin))
        console = screen()
        print_table(console, f"{b} over {a}", _texts(found.overall), texts=("accuracy", "solver"))
        print_notes(console, found.notes)
        if csv is not None:
            replace_file(csv, found.pairs.to_csv(index=False).encode())
            typer.echo(f"{csv}: {len(found.pairs)} pairs")
        for sentence in found.regressions[:WORST]:
            typer.echo(f"regression: {sentence}")
        if (more := len(found.regressions) - WORST) > 0:
            typer.echo(f"and {more} more, in the pairs of --csv")
    if found.regressions:
        raise typer.Exit(1)


@runs.command("merge")
def merge(
    parts: Annotated[list[Path], typer.Argument(metavar="A B...", help="Folders of runs.")],
    out: Annotated[Path, typer.Option(metavar="C", help="Folder of the run that they make together; new.")],
) -> None:
    """Make one run of several: parts of a set, or of the solvers, that were measured apart.

    Runs of different protocols are refused, with what differs. So is a measurement that is in two of them and differs
    in more than its clocks. The machines and versions of all are kept, row by row.

    Exit codes: 0 merged, 2 refused.

    Example: fibercontact runs merge runs/part1 runs/part2 --out runs/whole
    """
    with user_errors():
        from fibercontact.bench.merge import merge as merged
        from fibercontact.bench.record import read_run

        count = merged([read_run(part) for part in parts], out)
        typer.echo(f"{out}: {count} rows of {len(parts)} runs")


def _texts(overall: "pd.DataFrame") -> "pd.DataFrame":
    return overall.map(str)
