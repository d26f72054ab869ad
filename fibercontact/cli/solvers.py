"""`fibercontact solvers`: what local solvers and global methods there are."""

from pathlib import Path
from typing import Annotated

import typer

from fibercontact.cli.errors import user_errors

__all__ = ["Plugins", "solvers", "split_solvers"]

Plugins = Annotated[
    list[Path] | None,
    typer.Option("--plugin", metavar="FILE", help="A Python file with a solver; may be repeated."),
]


def solvers(plugin: Plugins = None) -> None:
    """List the local solvers, then the global methods: law, options with their defaults, where each comes from.

    Example: fibercontact solvers --plugin my_solver.py
    """
    with user_errors():
        from fibercontact.global_methods.registry import configure, is_global
        from fibercontact.peers.registry import registered

        known = registered(plugin or [])
        for name in sorted(known, key=lambda name: (is_global(known[name]), name)):
            entry, facets = known[name], configure(name, known).facets
            law = f"pyramid with {facets} facets" if facets else "Coulomb"
            kind = "global method; " if is_global(entry) else ""
            typer.echo(f"{name}  ({kind}{law}; {entry.origin})\n    {entry.summary}")
            for option, value in entry.solver.options.items():
                typer.echo(f"    {option}={value.default:g}  {value.meaning}")


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
