"""`fibercontact table --level 1` and `fibercontact harvest`: one-contact problems."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fibercontact.bench.protocol import DEFAULT_SOLVERS
from fibercontact.cli.errors import user_errors
from fibercontact.cli.options import Limit
from fibercontact.cli.screen import print_notes, print_table, progress_bar, screen

if TYPE_CHECKING:
    from fibercontact.bench.level1 import Measured
    from fibercontact.local.one_contact import OneContacts
    from fibercontact.local.registry import Configured

__all__ = ["harvest", "one_contact_table"]

FILE = "one_contact.h5"


def one_contact_table(
    contacts: str | None,
    solvers: "Sequence[Configured]",
    plugins: Sequence[Path],
    repetitions: int,
    limit: int | None,
    out: Path | None,
    max_seconds: float,
) -> None:
    """Measure, print and write the table of level 1."""
    from fibercontact.bench.level1 import Plan, measure
    from fibercontact.bench.problem_set import find_file
    from fibercontact.local.one_contact import read, read_counts

    path = find_file(contacts or FILE)
    plan = Plan(_limited(read(path), limit), solvers, plugins, max(5, repetitions), max_seconds)
    try:
        with progress_bar("", plan.replays) as show:
            measured = measure(plan, show)
    except KeyboardInterrupt:
        typer.echo("interrupted; nothing was written", err=True)
        raise typer.Exit(130) from None
    _finish(measured, read_counts(path), out or Path("runs") / path.stem)


def harvest(
    problems: Annotated[str, typer.Argument(metavar="SET", help="core306, or a folder of FCLIB files.")],
    out: Annotated[Path, typer.Option(metavar="FILE.h5", help="The one-contact set is written here.")],
    limit: Limit = None,
) -> None:
    """Take one-contact problems from inside Gauss–Seidel runs over a set, for `table --level 1`.

    Keeps a random sample of the visits, those that are hard for some local solver, and adds the synthetic hard set.
    The same file comes out of the same problems. Takes a quarter of an hour for core306.

    Example: fibercontact harvest core306 --out problems/one_contact.h5
    """
    with user_errors():
        from fibercontact.bench.harvest import harvest as take
        from fibercontact.bench.problem_set import find_set, limited, load_set
        from fibercontact.local.one_contact import write
        from fibercontact.local.registry import configure, registered

        known = registered()
        entries = limited(load_set(find_set(problems)), limit)
        with progress_bar("", len(entries)) as show:
            contacts, counts = take(entries, [configure(name, known) for name in DEFAULT_SOLVERS], show)
        write(out, contacts, counts)
        typer.echo(f"wrote {contacts.m} contacts to {out}")


def _limited(contacts: "OneContacts", limit: int | None) -> "OneContacts":
    """`limit` contacts spread evenly over the set, for trials."""
    if limit is None or limit >= contacts.m:
        return contacts
    return contacts.select([k * contacts.m // limit for k in range(limit)])


def _finish(measured: "Measured", counts: dict[str, int], folder: Path) -> None:
    """Print and write."""
    from fibercontact.bench.level1_report import grids, notes, write_report

    files = write_report(measured, counts, folder)
    console = screen()
    for grid in grids(measured):
        print_table(console, grid.title, grid.cells, texts=("solver", "reasons", "stratum"))
    print_notes(console, notes(measured, counts))
    typer.echo(f"{folder}: {', '.join(file.name for file in files)}")
