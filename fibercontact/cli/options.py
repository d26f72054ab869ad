"""Options and arguments that several commands have."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fibercontact.bench.protocol import ACCURACIES, OUTERS, STARTS
from fibercontact.cli.errors import check_known

if TYPE_CHECKING:
    from fibercontact.local.loading import Registered

__all__ = [
    "Accuracy", "Dask", "Limit", "MaxSeconds", "Memory", "Outer", "Plugins", "Start", "check_protocol", "in_bytes",
    "split_solvers", "with_plugins",
]  # fmt: skip


def _number(value: float) -> float:
    if math.isnan(value):
        raise typer.BadParameter("not a number")
    return value


Plugins = Annotated[
    list[Path] | None,
    typer.Option("--plugin", metavar="FILE", help="A Python file with a solver; may be repeated."),
]
Accuracy = Annotated[str, typer.Option(help=f"{', '.join(ACCURACIES)}.")]
Start = Annotated[str, typer.Option(help="cold (zero) or guess (the file's first).")]
Outer = Annotated[str, typer.Option(help="Gauss–Seidel: plain, accelerated or robust.")]
MaxSeconds = Annotated[
    float, typer.Option(help="Seconds a problem at most.", min=0, max=1e6, callback=_number)
]
Limit = Annotated[
    int | None, typer.Option(help="Only so many problems, spread over the set: a trial.", min=1)
]
Memory = Annotated[
    float | None,
    typer.Option(
        metavar="GB",
        min=0.5,
        help="Memory that a worker process may use; all together three quarters of the machine's by default.",
    ),
]
Dask = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="Do it on the Dask cluster of this scheduler, `tcp://HOST:8786`."),
]


def check_protocol(accuracies: Sequence[str], start: str, outer: str) -> None:
    """Raise `BenchError` on an accuracy, start or outer loop that is none."""
    check_known("accuracy", accuracies, list(ACCURACIES))
    check_known("start", [start], STARTS)
    check_known("outer loop", [outer], OUTERS)


def in_bytes(gigabytes: float | None) -> int | None:
    """Bytes in so many gigabytes (1e9); None where nothing is asked.

    >>> in_bytes(0.5)
    500000000
    """
    return None if gigabytes is None else int(1e9 * gigabytes)


def split_solvers(text: str) -> list[str]:
    """Split a list of specifications at its commas, except those between the options of a solver.

    >>> split_solvers("pac,mfb:tolerance=1e-9,iterations=50,secular")
    ['pac', 'mfb:tolerance=1e-9,iterations=50', 'secular']
    """
    found: list[str] = []
    for part in filter(None, (piece.strip() for piece in text.split(","))):
        if "=" in part and ":" not in part and found:
            found[-1] += f",{part}"
        else:
            found.append(part)
    return list(dict.fromkeys(found))


def with_plugins(
    given: Sequence[str], known: "Mapping[str, Registered[Any]]", plugins: Sequence[Path]
) -> list[str]:
    """The specifications given, each once, and the names of what the plugins hold."""
    files = {str(path) for path in plugins}
    return list(dict.fromkeys([*given, *(name for name in known if known[name].origin in files)]))
