"""Options of the commands whose work is done by worker processes."""

from typing import Annotated

import typer

__all__ = ["Dask", "Memory", "in_bytes"]

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


def in_bytes(gigabytes: float | None) -> int | None:
    """Bytes in so many gigabytes (1e9); None where nothing is asked.

    >>> in_bytes(0.5)
    500000000
    """
    return None if gigabytes is None else int(1e9 * gigabytes)
