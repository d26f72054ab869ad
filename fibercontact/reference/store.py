"""References kept on disk as FCLIB files: accepted ones as `solution`, the best of the others as a guess."""

import json
from dataclasses import asdict
from pathlib import Path

from fibercontact.problem.fclib import Solution, read, write
from fibercontact.problem.measure import measure
from fibercontact.problem.step import StepProblem
from fibercontact.reference.conic import Problem, condensed
from fibercontact.reference.truth import NONE, Attempt, Reference, reference

__all__ = ["stored_reference"]


def stored_reference(
    path: Path, problem: Problem, bar: float = 1e-10, max_seconds: float = 60.0
) -> Reference:
    """Read the reference of `problem` from a file, or find it and write it there.

    A file is believed by the residual of its impulses, measured anew; that there is no reference is believed
    when it was sought with the same bar and time. Raises `ProblemError` on a file that cannot be read, or
    that is about another problem.
    """
    sought = f"bar {bar:g}, {max_seconds:g} s"
    if path.exists() and (found := _load(path, problem, bar, sought)) is not None:
        return found
    found = reference(problem, bar, max_seconds)
    _save(path, problem, found, sought)
    return found


def _load(path: Path, problem: Problem, bar: float, sought: str) -> Reference | None:
    file = read(path)
    claim = file.solution or (file.guesses[0] if file.guesses else None)
    if claim is None or claim.r is None or claim.r.shape != (3 * problem.n,):
        return None
    residual = measure(condensed(problem), claim.r).coulomb
    attempts = tuple(Attempt(**fields) for fields in json.loads(file.description))
    if file.solution is not None and residual <= bar:
        return Reference(claim.r, residual, file.title, attempts)
    if file.solution is None and file.math_info == sought:
        return Reference(claim.r, residual, NONE, attempts)
    return None


def _save(path: Path, problem: Problem, found: Reference, sought: str) -> None:
    v = problem.velocities(found.r) if isinstance(problem, StepProblem) else None
    incremental = condensed(problem)
    answer = Solution(v=v, u=incremental.W @ found.r + incremental.b, r=found.r)
    path.parent.mkdir(parents=True, exist_ok=True)
    write(
        path,
        problem,
        title=found.method,
        description=json.dumps([asdict(attempt) for attempt in found.attempts]),
        math_info=sought,
        solution=answer if found.accepted else None,
        guesses=() if found.accepted else (answer,),
    )
