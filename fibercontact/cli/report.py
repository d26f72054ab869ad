"""`fibercontact report`: runs as one page for a browser."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fibercontact.cli.errors import user_errors
from fibercontact.cli.options import Plugins

if TYPE_CHECKING:
    from fibercontact.bench.html_report.page import Shown
    from fibercontact.bench.html_report.runs import RunRead

__all__ = ["report"]


def report(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Folders that `table --out` wrote.")],
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The page; RUN/report.html, or report.html for several."),
    ] = None,
    curves: Annotated[int, typer.Option(help="Problems a run to draw convergence of.", min=0)] = 6,
    problem: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="This problem instead; may be repeated.")
    ] = None,
    rods: Annotated[
        int, typer.Option(help="Of these, so many with rods and contacts: their scenes are run again.", min=0)
    ] = 2,
    problems: Annotated[
        list[Path] | None,
        typer.Option("--set", metavar="FOLDER", help="Where their files are, beside problems/; repeatable."),
    ] = None,
    plugin: Plugins = None,
) -> None:
    """Write one self-contained HTML page about runs: tables, figures, problems, environment, limitations.

    The page opens offline and asks the network for nothing. Rows hold no histories: the problems whose convergence
    is drawn are solved again, each by each solver for 5 s at most. A run that is not finished is reported as such.

    For example:

    fibercontact report runs/core306

    fibercontact report runs/core306 runs/mine --curves 2 --out both.html

    fibercontact report runs/mine --set my_problems/ --plugin my_solver.py --problem one
    """
    with user_errors():
        from fibercontact.bench.html_report.page import write_page
        from fibercontact.bench.html_report.runs import renamed, reported

        found = renamed([reported(folder) for folder in runs])
        file = out or (runs[0] / "report.html" if len(runs) == 1 else Path("report.html"))
        _check(file, problems or [], problem or [], found)
        shown = [_shown(run, curves, problem or [], rods, problems or [], plugin or []) for run in found]
        size = write_page(shown, file)
        for run in found:
            for remark in run.remarks:
                typer.echo(f"{run.name}: {remark}", err=True)
        typer.echo(f"wrote {file}: {size / 1e6:.1f} MB")


def _check(file: Path, folders: list[Path], names: list[str], runs: "Sequence[RunRead]") -> None:
    """Refuse what cannot be read or written, before anything is computed."""
    from fibercontact.bench.protocol import BenchError

    if file.is_dir() or not file.parent.is_dir():
        raise BenchError(f"{file}: {'a folder' if file.is_dir() else f'no such folder as {file.parent}'}")
    for folder in folders:
        if not folder.is_dir():
            raise BenchError(f"{folder}: no such folder")
    for name in names:
        if not any((run.rows["problem"] == name).any() for run in runs):
            raise BenchError(f"no problem {name!r} in {', '.join(run.name for run in runs)}")


def _shown(
    run: "RunRead", curves: int, names: list[str], rods: int, folders: list[Path], plugins: list[Path]
) -> "Shown":
    """A run with the problems that are looked at closely."""
    from rich.console import Console
    from rich.markup import escape

    from fibercontact.bench.html_report.choice import chosen, named
    from fibercontact.bench.html_report.page import Shown
    from fibercontact.bench.html_report.portraits import portraits, strictest
    from fibercontact.bench.problem_set import known_sets

    rows = strictest(run.views).rows
    hashes = named(rows, names) if names else chosen(rows, curves)
    with Console(stderr=True).status("") as status:

        def tell(text: str) -> None:
            status.update(escape(text))

        places = [*folders, *known_sets()]
        return Shown(run, portraits(run, hashes, places, plugins, rods, tell))
