"""Tables on the screen."""

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pandas import DataFrame
    from rich.console import Console

__all__ = ["print_table", "screen"]


def screen() -> "Console":
    """Standard output, as wide as the terminal, or wide enough for any table when it is none."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else 200)


def print_table(console: "Console", title: str, table: "DataFrame") -> None:
    """Print a table of texts."""
    from rich.table import Table

    grid = Table(*map(str, table.columns), title=title, title_justify="left")
    for line in table.itertuples(index=False):
        grid.add_row(*map(str, line))
    console.print(grid)
