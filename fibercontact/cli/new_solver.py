"""`fibercontact new-solver`: a local solver, or a global method, to start from."""

import keyword
import sys
from pathlib import Path
from typing import Annotated

import typer

from fibercontact.cli.errors import user_errors

__all__ = ["new_solver"]


def new_solver(
    name: Annotated[str, typer.Argument(metavar="NAME", help="What to call it, for instance my-solver.")],
    out: Annotated[
        Path | None, typer.Option(metavar="FILE.py", help="Where to write it; NAME.py by default.")
    ] = None,
    whole: Annotated[bool, typer.Option("--global", help="A method for the whole problem instead.")] = False,
) -> None:
    """Write a local solver to start from: one file, working and commented, that passes `fibercontact check`.

    With --global, a method for the whole problem, also working and commented.

    Example: fibercontact new-solver my-solver
    """
    with user_errors():
        file = out or Path(f"{name.replace('-', '_')}.py")
        _check_name(file.stem)
        with file.open("x", encoding="utf-8") as stream:
            stream.write(_template(whole))
    typer.echo(f"{file} written; it works as it is. Next:")
    others = "secular,apgd" if whole else "hybrid,secular"
    if not whole:
        typer.echo(f"  fibercontact check {file}")
    typer.echo(f"  fibercontact table --plugin {file} --solvers {others} --limit 20 --out runs/{file.stem}")


def _check_name(module: str) -> None:
    """Raise `SolverError` unless a file and a solver can have this name."""
    from fibercontact.global_methods.registry import registered
    from fibercontact.local.loading import SolverError

    name = module.replace("_", "-")
    if not module.isidentifier() or keyword.iskeyword(module):
        raise SolverError(f"{module!r} cannot name a Python module: take letters, digits and dashes")
    if module in sys.stdlib_module_names:
        raise SolverError(f"{module!r} is a module of Python itself, which a file of that name would hide")
    if name in registered():
        raise SolverError(f"{name!r} is a solver already: take another name")


def _template(whole: bool) -> str:
    from fibercontact.global_methods import template as method
    from fibercontact.local import template as local

    return Path(str((method if whole else local).__file__)).read_text(encoding="utf-8")
