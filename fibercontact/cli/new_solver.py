"""`fibercontact new-solver`: a local solver to start from."""

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
) -> None:
    """Write a local solver to start from: one file, working and commented, that passes `fibercontact check`.

    Example: fibercontact new-solver my-solver
    """
    with user_errors():
        file = out or Path(f"{name.replace('-', '_')}.py")
        _check_name(file.stem)
        with file.open("x", encoding="utf-8") as stream:
            stream.write(_template())
    typer.echo(f"{file} written; it works as it is. Next:")
    typer.echo(f"  fibercontact check {file}")
    typer.echo(
        f"  fibercontact table --plugin {file} --solvers hybrid,secular --limit 20 --out runs/{file.stem}"
    )


def _check_name(module: str) -> None:
    """Raise `SolverError` unless a file and a solver can have this name."""
    from fibercontact.local.registry import SolverError, registered

    name = module.replace("_", "-")
    if not module.isidentifier() or keyword.iskeyword(module):
        raise SolverError(f"{module!r} cannot name a Python module: take letters, digits and dashes")
    if module in sys.stdlib_module_names:
        raise SolverError(f"{module!r} is a module of Python itself, which a file of that name would hide")
    if name in registered():
        raise SolverError(f"{name!r} is a solver already: take another name")


def _template() -> str:
    from fibercontact.local import template

    return Path(str(template.__file__)).read_text(encoding="utf-8")
