"""Tables in Markdown."""

from collections.abc import Iterable
from typing import Any

__all__ = ["grid"]


def grid(columns: Iterable[Any], rows: Iterable[Iterable[Any]]) -> list[str]:
    r"""The lines of a table.

    >>> print("\n".join(grid(["a", "b|c"], [[1, "two"]])))
    | a | b\|c |
    | --- | --- |
    | 1 | two |
    """
    head = list(columns)
    lines = (head, ["---"] * len(head), *rows)
    return ["| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |" for line in lines]
