"""Whether a problem has a solution, with a certificate (THEORY §5).

* *solvable*: impulses z with `b + W z ∈ int K_mu*` at every contact; a solution then exists.
* *unsolvable*: normal impulses r >= 0 with `W r = 0`, `bᵀ r < 0`; no velocity keeps the contacts from penetrating.
* *undecided*: neither was found.

The first is the convex problem of a velocity that leaves the cones `K_mu*` by a margin at least; the second is
Farkas' certificate that the same problem without friction and margin has no feasible velocity. Both are checked by
`recheck`, which shares nothing with what found them and allows for rounding.

References: [Cadoux 2009]; [Acary, Cadoux, Lemaréchal & Malick 2011] ZAMM 91.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.reference.conic import Problem, condensed, default_form
from fibercontact.reference.recheck import solvable_slack, unsolvable_radius

__all__ = ["SOLVABLE", "UNDECIDED", "UNSOLVABLE", "Existence", "existence", "recheck"]

Array = NDArray[np.float64]

SOLVABLE, UNSOLVABLE, UNDECIDED = "solvable", "unsolvable", "undecided"
MARGINS = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
"""Slacks asked for, relative to `b_ref`, until one can be had."""
LEAST_RADIUS = 1e3
"""Impulses, relative to b in velocity units, that a certificate in rounded numbers must exclude to be one."""


@dataclass(frozen=True)
class Existence:
    """The verdict with its certificate (3n,) in N·s, and what the check of it gave.

    `margin` is the slack of a solvable problem relative to `b_ref`; of an unsolvable one, the size of the impulses,
    relative to b in velocity units, up to which the rounded certificate excludes a solution.
    """

    verdict: str
    certificate: Array
    margin: float


def existence(problem: Problem) -> Existence:
    """Look for a certificate of either kind."""
    incremental = condensed(problem)
    model = default_form(problem)
    for margin in MARGINS:
        z = model.solve_shifted(np.full(problem.n, -margin * (incremental.b_ref or 1.0))).r
        if (slack := recheck(incremental, SOLVABLE, z)) > 0.0:
            return Existence(SOLVABLE, z, slack)
    without_friction = dataclasses.replace(problem, mu=np.zeros(problem.n))
    r = default_form(without_friction).solve(np.zeros(problem.n)).r * np.tile([1.0, 0.0, 0.0], problem.n)
    r = np.maximum(r, 0.0)
    radius = recheck(incremental, UNSOLVABLE, r)
    if radius > LEAST_RADIUS:
        return Existence(UNSOLVABLE, r, radius)
    return Existence(UNDECIDED, np.zeros(3 * problem.n), 0.0)


def recheck(problem: IncrementalProblem, verdict: str, certificate: Array) -> float:
    """What a certificate is worth, computed from `(W, b, mu)` alone; not positive when it proves nothing."""
    if not np.isfinite(certificate).all():
        return 0.0
    if verdict == SOLVABLE:
        return solvable_slack(problem.W, problem.b, problem.mu, certificate)
    return unsolvable_radius(problem.W, problem.b, certificate) if verdict == UNSOLVABLE else 0.0
