"""Whether other starts lead to other velocities: Coulomb's law may have several solutions.

That they do not is no proof of uniqueness; that they do is one of the contrary, each solution being accepted by its
residual as a reference is.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.reference.conic import Problem, condensed
from fibercontact.reference.distance import velocity_error
from fibercontact.reference.truth import Reference, reference

__all__ = ["DIFFERENT", "Uniqueness", "random_impulse", "uniqueness"]

Array = NDArray[np.float64]

DIFFERENT = 2e-4
"""Distance of velocities, see `velocity_error`, above which two solutions are different ones.

On core306 accepted answers are less than 3e-5 apart, which residual and conditioning explain, or more than 1e-3.
"""


@dataclass(frozen=True)
class Uniqueness:
    """What other starts led to.

    `others` are solutions (3n,) with velocities of their own; `distance` is the largest velocity error of an
    accepted answer relative to the reference.
    """

    tried: int
    reached: int
    distance: float
    others: tuple[Array, ...]


def uniqueness(
    problem: Problem, truth: Reference, associated: Array, bar: float, max_seconds: float, starts: int
) -> Uniqueness:
    """Look for other solutions than the accepted `truth`, from `starts` starts: the associated one, random ones.

    Without friction the problem is convex and its velocities are unique: no start is tried.
    """
    incremental = condensed(problem)
    starts = starts if problem.mu.any() else 0
    reached, distances, others = 0, [0.0], [truth.r]
    for k in range(starts):
        start = (
            associated
            if k == 0 and np.isfinite(associated).all()
            else random_impulse(incremental, truth.r, k)
        )
        found = reference(problem, bar, max_seconds, start)
        if not found.accepted:
            continue
        reached += 1
        distances.append(velocity_error(problem, found.r, truth.r))
        if all(velocity_error(problem, found.r, other) > DIFFERENT for other in others):
            others.append(found.r)
    return Uniqueness(starts, reached, max(distances), tuple(others[1:]))


def random_impulse(problem: IncrementalProblem, r: Array, seed: int) -> Array:
    """Impulses (3n,) as large as `r` all in all, at every contact, with full friction in a random direction."""
    rng = np.random.default_rng(seed)
    size = np.sqrt(np.mean((problem.sigma * r[::3]) ** 2)) or problem.b_ref
    normal = rng.exponential(size, problem.n) / problem.sigma
    angle = rng.uniform(0.0, 2.0 * np.pi, problem.n)
    friction = problem.mu * normal
    return np.column_stack([normal, friction * np.cos(angle), friction * np.sin(angle)]).ravel()
