"""Tables on the screen."""

import sys
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pandas import DataFrame
    from rich.console import Console

__all__ = ["bar", "print_notes", "print_table", "screen"]


def screen() -> "Console":
    """Standard output, as wide as the terminal, or wide enough for any table when it is none."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else 200)


def print_table(console: "Console", title: str, table: "DataFrame", texts: Collection[str] = ()) -> None:
    """Print a table of texts; columns that are not among `texts` stand to the right, if any are."""
    from rich.table import Table

    grid = Table(title=title, title_justify="left")
    for column in table.columns:
        left = not texts or column in texts
        grid.add_column(column, justify="left" if left else "right", no_wrap=column == "solver")
    for line in table.itertuples(index=False):
        grid.add_row(*map(str, line))
    console.print(grid)


def print_notes(console: "Console", notes: Iterable[str]) -> None:
    """Print what must be said beside a table."""
    for note in notes:
        console.print(f"• {note}", markup=False, highlight=False)


@contextmanager
def bar(title: str, total: int) -> Iterator[Callable[[], None]]:
    """A bar on stderr, one step further whenever what it gives is called."""
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(escape(title), total=total)
        yield lambda: progress.advance(task)
