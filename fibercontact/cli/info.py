"""`fibercontact info`: what is in an FCLIB file."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fibercontact.cli.errors import user_errors

if TYPE_CHECKING:
    from fibercontact.problem.fclib import FclibFile, Solution
    from fibercontact.problem.incremental import IncrementalProblem

__all__ = ["info"]

RANK_LIMIT = 300  # contacts up to which the rank is computed, by dense eigenvalues


def info(file: Annotated[Path, typer.Argument(metavar="FILE", help="An FCLIB file (HDF5).")]) -> None:
    """Describe the problem in an FCLIB file: sizes, friction, conditioning, guesses and solution.

    Example: fibercontact info problems/core306/FILE.hdf5
    """
    with user_errors():
        from fibercontact.problem.fclib import read
        from fibercontact.problem.incremental import IncrementalProblem

        found = read(file)
        local = isinstance(found.problem, IncrementalProblem)
        problem = found.problem if isinstance(found.problem, IncrementalProblem) else found.problem.condense()
        kind = "fclib_local (W, b, mu)" if local else "fclib_global (M, f, H, w, mu)"
        lines = [
            ("title", found.title or "–"),
            ("kind", kind),
            *_sizes(found, problem),
            *_claims(found, problem),
        ]
        for name, text in lines:
            typer.echo(f"{name:<22}{text}")


def _sizes(found: "FclibFile", problem: "IncrementalProblem") -> Iterator[tuple[str, str]]:
    yield "contacts", str(problem.n)
    if hasattr(found.problem, "d"):
        yield "degrees of freedom", str(found.problem.d)
    if problem.n == 0:
        return
    import numpy as np

    eigenvalues = np.linalg.eigvalsh(problem.diagonal)
    with np.errstate(divide="ignore"):
        condition = eigenvalues[:, 2] / np.maximum(eigenvalues[:, 0], 0.0)
    yield "mu", f"{problem.mu.min():g} to {problem.mu.max():g}"
    yield "blocks a row", f"{len(problem.W.indices) / problem.n:.1f}"
    if problem.n <= RANK_LIMIT:
        yield "rank of W", f"{np.linalg.matrix_rank(problem.W.toarray(), hermitian=True)} of {3 * problem.n}"
    yield "condition of W_ii", f"{condition.min():.2g} to {condition.max():.2g}"
    yield "b_ref", f"{problem.b_ref:.3g} m/s"


def _claims(found: "FclibFile", problem: "IncrementalProblem") -> Iterator[tuple[str, str]]:
    """The file's guesses and solution, measured."""
    yield "guesses", str(len(found.guesses))
    for number, guess in enumerate(found.guesses, start=1):
        yield f"  guess {number}", _worth(guess, problem)
    yield "solution", _worth(found.solution, problem) if found.solution else "none"


def _worth(claim: "Solution", problem: "IncrementalProblem") -> str:
    from fibercontact.problem.measure import measure

    if claim.r is None:
        return "no impulses in it"
    return f"residual {measure(problem, claim.r).residual:.2e}"
