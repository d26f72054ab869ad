"""Tables on the screen."""

import os
import sys
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from itertools import takewhile
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pandas import DataFrame
    from rich.console import Console

__all__ = ["print_notes", "print_table", "progress_bar", "screen"]


WRAPPED = 24  # characters at which the text in a column may be wrapped


def screen() -> "Console":
    """Standard output, as wide as the terminal or `COLUMNS`, or wide enough for any table when there is neither."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() or "COLUMNS" in os.environ else 200)


def print_table(console: "Console", title: str, table: "DataFrame", texts: Collection[str] = ()) -> None:
    """Print a table of texts; columns that are not among `texts` stand to the right, if any are.

    A table too wide for the screen comes in parts, one below the other, each with what its lines are about.
    """
    for columns in _fitting(table, texts, console.width):
        _print_grid(console, title, table[columns], texts)
        title = ""


def _fitting(table: "DataFrame", texts: Collection[str], width: int) -> Iterator[list[str]]:
    """The columns in groups that fit on the screen, each with the first texts, or the first column."""
    keys = list(takewhile(lambda column: column in texts, table.columns)) or list(table.columns[:1])
    group = list(keys)
    for column in table.columns[len(keys) :]:
        if len(group) > len(keys) and _size(table[[*group, column]]) > width:
            yield group
            group = list(keys)
        group.append(column)
    yield group


def _size(table: "DataFrame", wrapped: bool = True) -> int:
    """Characters that a table takes, its headings and long texts wrapped or not."""
    return 1 + sum(3 + _width(table, column, wrapped) for column in table.columns)


def _width(table: "DataFrame", column: str, wrapped: bool = True) -> int:
    longest = max(map(len, table[column].astype(str)), default=0)
    words = [min(longest, WRAPPED), *map(len, column.split())]
    return max(words) if wrapped else max(longest, len(column))


def _print_grid(console: "Console", title: str, table: "DataFrame", texts: Collection[str]) -> None:
    from rich.markup import escape
    from rich.table import Table

    grid = Table(title=escape(title) or None, title_justify="left")
    tight = _size(table) <= console.width < _size(table, wrapped=False)
    for column in table.columns:
        left = not texts or column in texts
        width = _width(table, column) if tight else None
        grid.add_column(escape(column), justify="left" if left else "right", width=width)
    for line in table.itertuples(index=False):
        grid.add_row(*(escape(str(cell)) for cell in line))
    console.print(grid)


def print_notes(console: "Console", notes: Iterable[str]) -> None:
    """Print what must be said beside a table."""
    for note in notes:
        console.print(f"• {note}", markup=False, highlight=False)


@contextmanager
def progress_bar(title: str, total: int, done: int = 0) -> Iterator[Callable[..., None]]:
    """A bar on stderr; calling what it gives takes it one step further, with a text in the title's place if given."""
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(escape(title), total=total, completed=done)
        yield lambda text=title: progress.update(task, advance=1, description=escape(text))
