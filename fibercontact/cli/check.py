"""`fibercontact check`: whether a local solver keeps the contract."""

import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fibercontact.cli.errors import user_errors

if TYPE_CHECKING:
    from rich.table import Table

    from fibercontact.bench.conformance.suite import Verdict
    from fibercontact.local.registry import Configured

__all__ = ["check"]


def check(
    solver: Annotated[
        str,
        typer.Argument(
            metavar="SOLVER", help="A plugin's FILE.py, or a NAME; `:option=value,...` may follow."
        ),
    ],
    seconds: Annotated[
        float, typer.Option(help="What a check may take before the solver is killed.", min=0.1, max=1e6)
    ] = 10.0,
    out: Annotated[
        Path | None,
        typer.Option(metavar="CARD.md", help="Where to write the card; runs/check/NAME.md by default."),
    ] = None,
) -> None:
    """Check a local solver against the contract: a report card on the screen and as Markdown.

    Answers that are known exactly, honesty, invariance, determinism, data that are not finite: the contract is in
    `fibercontact/local/contract.py`. The solver runs in a process that is killed when it hangs. Speed and the hard
    contacts it misses are reported, and no breach.

    The exit code is 0 only when the contract holds; 1 when it does not; 2 for an error.

    For example:

    fibercontact check my_solver.py

    fibercontact check pyramid:facets=8
    """
    with user_errors():
        from fibercontact.bench.conformance.apart import examine_apart
        from fibercontact.bench.conformance.card import headline, markdown
        from fibercontact.bench.conformance.suite import holds
        from fibercontact.files import replace_file

        plugins, local = _find(solver)
        verdicts = _show(examine_apart(local, plugins, seconds), local)
        card = out or Path("runs", "check", f"{_file_name(local.label)}.md")
        card.parent.mkdir(parents=True, exist_ok=True)
        replace_file(card, markdown(local, verdicts).encode())
        typer.echo(f"{headline(local, verdicts)} ({card})")
    if not holds(verdicts):
        raise typer.Exit(1)


def _find(text: str) -> "tuple[Sequence[Path], Configured]":
    """The solver named on the command line, and the plugin it comes from."""
    from fibercontact.local.registry import configure, registered

    name, _, options = text.partition(":")
    if not name.endswith(".py"):
        return [], configure(text, registered())
    file = Path(name)
    specification = file.stem.replace("_", "-") + (f":{options}" if options else "")
    return [file], configure(specification, registered([file]))


def _file_name(label: str) -> str:
    return "".join(c if c.isalnum() or c in "-_." else "-" for c in label)


def _show(verdicts: "Iterable[Verdict]", local: "Configured") -> "list[Verdict]":
    """Print the card, and say meanwhile what is being looked at."""
    from rich.console import Console

    from fibercontact.bench.conformance.card import COLUMNS, lines_of

    console = Console(width=None if sys.stdout.isatty() else 160, highlight=False)
    found = []
    with Console(stderr=True).status(
        f"{local.label}: starting (the first time, compiling: a minute)"
    ) as status:
        for verdict in verdicts:
            found.append(verdict)
            status.update(f"{local.label}: {verdict.check} {verdict.outcome}")
    console.print(_grid(COLUMNS, lines_of(found)))
    for verdict in found:
        if verdict.table:
            console.print(_grid(verdict.table.columns, verdict.table.rows, verdict.check))
        if verdict.detail:
            console.print(
                f"\n{verdict.check}: {verdict.sentence}", markup=False, style="bold", soft_wrap=True
            )
            console.print(verdict.detail, markup=False, soft_wrap=True)
    return found


def _grid(columns: Sequence[str], rows: Iterable[Sequence[str]], title: str = "") -> "Table":
    from rich.markup import escape
    from rich.table import Table

    grid = Table(*columns, title=title or None, title_justify="left")
    for row in rows:
        grid.add_row(*map(escape, row), style="bold red" if "FAIL" in row else None)
    return grid
