"""`fibercontact validate`: the solvers' answers compared with convex references."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fibercontact.bench.protocol import ACCURACIES, DEFAULT_SOLVERS
from fibercontact.cli.errors import check_known, user_errors
from fibercontact.cli.options import Limit, Plugins, split_solvers, with_plugins
from fibercontact.cli.screen import print_notes, print_table, screen

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from fibercontact.bench.validate import Comparison, Contender, Listener

__all__ = ["validate"]


def validate(
    problems: Annotated[
        str, typer.Option("--set", metavar="SET", help="core306, sample, or a folder of FCLIB files.")
    ] = "core306",
    solvers: Annotated[
        str | None,
        typer.Option(
            metavar="A,B,...",
            help="Local solvers, `NAME[:option=value,...]`, or `associated`, the convex model; all by default.",
        ),
    ] = None,
    plugin: Plugins = None,
    accuracy: Annotated[
        str, typer.Option(help=f"What the solvers stop at: {', '.join(ACCURACIES)}.")
    ] = "mid",
    max_contacts: Annotated[int, typer.Option(help="Larger problems are skipped.", min=0)] = 3000,
    references: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="References; SET.references.hdf5 beside the set by default."),
    ] = None,
    limit: Limit = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Run folder; runs/SET-validation by default.")
    ] = None,
) -> None:
    """Compare the solvers' answers with references: residual, velocities, regimes, work of friction.

    References that are not stored yet are looked for (`fibercontact reference` does it in parallel); problems without
    one are listed as `none`. References and rows are written as they come: the same command continues a run
    that was interrupted. The run folder gets the rows (CSV), the tables (Markdown) and a figure of velocity error
    against residual.

    For example:

    fibercontact validate --limit 20

    fibercontact validate --set my_problems/ --solvers hybrid,pyramid:facets=16 --accuracy high
    """
    with user_errors():
        check_known("accuracy", [accuracy], list(ACCURACIES))
        from fibercontact.bench.problem_set import find_set, limited, load_set
        from fibercontact.bench.validate import validate as compare
        from fibercontact.reference.ground_truth import Search
        from fibercontact.reference.store import references_file

        folder = find_set(problems)
        entries = limited(load_set(folder), limit)
        contenders = _contenders(solvers, plugin or [], accuracy)
        out = out or Path("runs") / f"{folder.resolve().name}-validation"
        try:
            with _listening(len(entries)) as listener:
                comparison = compare(
                    entries,
                    contenders,
                    out,
                    listener,
                    references=references or references_file(folder),
                    search=Search(),
                    max_contacts=max_contacts,
                )
        except KeyboardInterrupt:
            typer.echo(f"interrupted; the same command continues from {out}", err=True)
            raise typer.Exit(130) from None
        _finish(comparison, out)


def _contenders(solvers: str | None, plugins: list[Path], accuracy: str) -> "list[Contender]":
    from fibercontact.bench.validate import ASSOCIATED, associated_model, contender
    from fibercontact.local.registry import configure, registered

    known = registered(plugins)
    names = split_solvers(solvers) if solvers is not None else [*DEFAULT_SOLVERS, *known, ASSOCIATED]
    return [
        associated_model() if name == ASSOCIATED else contender(configure(name, known), accuracy)
        for name in with_plugins(names, known, plugins)
    ]


@contextmanager
def _listening(total: int) -> "Iterator[Listener]":
    """A listener with a progress bar over the problems, on stderr."""
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as progress:
        yield _Bar(progress, progress.add_task("validate", total=total))


class _Bar:
    def __init__(self, progress: "Progress", task: "TaskID") -> None:
        self.progress, self.task = progress, task

    def now(self, problem: str, what: str) -> None:
        from rich.markup import escape

        self.progress.update(self.task, description=escape(f"{problem} {what}"))

    def done(self, problem: str) -> None:
        self.progress.advance(self.task)

    def note(self, text: str) -> None:
        self.progress.console.print(text, markup=False, highlight=False)


def _finish(comparison: "Comparison", folder: Path) -> None:
    from fibercontact.bench.validate_report import notes, reference_table, solver_table, write_report

    console = screen()
    if comparison.references:
        files = write_report(comparison, folder)
        print_table(console, "references", reference_table(comparison))
        print_table(console, "solvers against references", solver_table(comparison))
        typer.echo(f"{folder}: {', '.join(file.name for file in files)}")
    print_notes(console, notes(comparison))
