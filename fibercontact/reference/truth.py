"""References: answers accurate enough to judge others by, accepted by their residual alone (THEORY §5).

Candidates, in order, until one is accepted; each but the first ends in accelerated proximal sweeps with the `secular`
local solver, because Clarabel floors at residuals of 1e-6 to 1e-10:

1. `no impulse`, `r = 0`: free.
2. `sweeps` from zero, for a short time: what most problems need, in the tenth part of the time of 4.
3. `central path` of Coulomb's law: jammed and ill-conditioned problems, on which sweeps from zero stall. Its start is
   its own, so it is not tried when one is given, nor where its factors may not fit into memory.
4. `Cadoux`, in velocities where they are known: it starts the sweeps where hundreds of them converge, from a given
   start too, and shares nothing with 2 and 3 but the polishing.
5. `sharp Cadoux`, in impulses and with hardly any regularisation: it floors lower on the most ill-conditioned
   problems, and without friction, where the velocity form is spoiled by inactive contacts.
6. `sweeps`, for long.

`none` is an answer too: then the best candidate is kept with its residual, and is not the truth. What each candidate
solves alone is measured by `experiments/reference_methods.py`.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fibercontact.gauss_seidel.anderson import Acceleration
from fibercontact.gauss_seidel.blocks import block_system
from fibercontact.gauss_seidel.interior_point import interior_point
from fibercontact.gauss_seidel.solver import LARGEST_RESCUE, GaussSeidel
from fibercontact.local.registry import configure, registered
from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.problem.measure import measure
from fibercontact.reference.cadoux import Cadoux, sliding_speed
from fibercontact.reference.conic import Form, Problem, condensed, default_form, sharp_form

__all__ = ["NONE", "Attempt", "Reference", "polish", "reference"]

Array = NDArray[np.float64]

NONE = "none"
MARGIN = 0.01  # share of the bar that candidates aim at
SHORT_SECONDS = 2.0  # of the first sweeps
POLISH_SECONDS = 10.0


@dataclass(frozen=True)
class Attempt:
    """A candidate: how it was found, its residual of Coulomb's law, seconds, and what happened."""

    method: str
    residual: float
    seconds: float
    note: str


@dataclass(frozen=True)
class Reference:
    """Impulses `r` (3n,) in N·s with their residual; the truth only when `accepted`.

    `r` is not unique: compare velocities. They may not be unique either, and then this is one of the solutions.
    """

    r: Array
    residual: float
    method: str
    """The candidate that was accepted, or `none`."""
    attempts: tuple[Attempt, ...]

    @property
    def accepted(self) -> bool:
        """Whether this is the truth."""
        return self.method != NONE


def reference(
    problem: Problem, bar: float = 1e-10, max_seconds: float = 120.0, start: Array | None = None
) -> Reference:
    """Find a reference whose residual is at most `bar`, `none` if `max_seconds` or so do not suffice.

    Sweeps begin at the impulses `start` (3n,), Cadoux's loop at the sliding speeds that they leave; at zero by
    default, both of them. Raises `ProblemError` if the `M` of a step is not positive definite.
    """
    incremental = condensed(problem)
    polish(incremental, None, np.inf, 0.0)  # compiles: before the clock starts
    best, least, attempts = np.zeros(3 * problem.n), np.inf, []
    began = time.perf_counter()
    for method, r, note in _candidates(problem, incremental, MARGIN * bar, max_seconds, start):
        residual, now = measure(incremental, r).coulomb, time.perf_counter()
        attempts.append(Attempt(method, residual, now - began, note))
        began = now
        if residual < least:
            best, least = r, residual
        if residual <= bar:
            return Reference(r, residual, method, tuple(attempts))
    return Reference(best, least, NONE, tuple(attempts))


def polish(
    problem: IncrementalProblem, start: Array | None, tolerance: float, max_seconds: float
) -> tuple[Array, str]:
    """Accelerated proximal sweeps from `start` (3n,), zero by default: the best impulses, and a note."""
    loop = GaussSeidel(
        configure("secular", registered()),
        tolerance,
        max_sweeps=10**9,
        max_seconds=max_seconds,
        proximal=0.1,
        acceleration=Acceleration(sweeps=10, window=20),
        rescue_after=0,
    )
    run = loop.solve(problem, start)
    return run.r, f"{run.sweeps} sweeps, {run.outcome.sentence}"


def _candidates(
    problem: Problem, incremental: IncrementalProblem, target: float, max_seconds: float, start: Array | None
) -> Iterator[tuple[str, Array, str]]:
    """Candidates with their names and notes, computed one at a time as they are asked for."""
    share = 0.25 * max_seconds
    slip = np.zeros(problem.n) if start is None else sliding_speed(incremental, start)
    if start is None:
        yield "no impulse", np.zeros(3 * problem.n), ""
    yield "sweeps", *polish(incremental, start, target, min(SHORT_SECONDS, share))
    if start is None and len(incremental.W.indices) <= LARGEST_RESCUE:
        yield "central path", *_polished_path(incremental, target, share)
    yield "Cadoux", *_polished_cadoux(problem, incremental, default_form, slip, target, share)
    yield "sharp Cadoux", *_polished_cadoux(problem, incremental, sharp_form, slip, target, share)
    yield "long sweeps", *polish(incremental, start, target, share)


def _polished_path(problem: IncrementalProblem, target: float, share: float) -> tuple[Array, str]:
    unit = problem.b_ref or 1.0
    run = interior_point(block_system(problem), unit, target * unit, deadline=time.perf_counter() + share)
    r, note = polish(problem, run.r, target, min(POLISH_SECONDS, share))
    return r, f"{run.residual / unit:.1e} after {run.iterations} iterations, {note}"


def _polished_cadoux(
    problem: Problem, incremental: IncrementalProblem, form: Form, slip: Array, target: float, share: float
) -> tuple[Array, str]:
    run = Cadoux(form, target, max_seconds=share).solve(problem, slip)
    r, note = polish(incremental, run.r, target, min(POLISH_SECONDS, share))
    return (
        r,
        f"{run.residual:.1e} after {run.iterations} iterations ({run.stage}), {note}",
    )
