"""`fibercontact solvers`: what local solvers and global methods there are."""

import typer

from fibercontact.cli.errors import user_errors
from fibercontact.cli.options import Plugins

__all__ = ["solvers"]


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
