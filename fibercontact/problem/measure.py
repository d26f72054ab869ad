"""How a candidate impulse is measured (THEORY §2), from `(W, b, mu, r)` alone."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fibercontact.jit import jit
from fibercontact.problem.cone import COULOMB, change_of_variable, fischer_burmeister, natural_map
from fibercontact.problem.incremental import IncrementalProblem

__all__ = ["Measure", "measure", "relative"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Measure:
    """What a candidate impulse is worth; the residuals are relative to `b_ref`, the defects are maxima."""

    residual: float
    """Natural map of the law asked for (the verdict)."""
    coulomb: float
    """Natural map of Coulomb's law."""
    fischer_burmeister: float
    """Fischer–Burmeister function of [Daviet 2011] on `(sigma r, ũ)`."""
    penetration: float
    """Largest `max(-u_N, 0)`, m/s."""
    cone_violation: float
    """Largest distance of `r` to the Coulomb cone, N·s."""
    complementarity: float
    """Largest `|u_N r_N|`, J."""
    created_power: float
    """Largest `max(u_T·r_T, 0)`, J: work that friction would create."""
    misalignment: float
    """Largest angle between `-u_T` and `r_T` where the contact slips, rad."""


def relative(size: float, b_ref: float) -> float:
    """A residual in the unit of b, relative to `b_ref`; absolute when `b = 0`."""
    return size / b_ref if b_ref > 0.0 else size


@jit
def _sums(u: Array, r: Array, mu: Array, sigma: Array, facets: int, squares: Array) -> None:
    """Add the squared norms of the three residuals to `squares`: the law's, Coulomb's, Fischer–Burmeister's."""
    for i in range(len(mu)):
        ui = (u[3 * i], u[3 * i + 1], u[3 * i + 2])
        ri = (r[3 * i], r[3 * i + 1], r[3 * i + 2])
        y = change_of_variable(ui, mu[i], COULOMB)
        maps = (
            natural_map(ui, ri, mu[i], sigma[i], facets),
            natural_map(ui, ri, mu[i], sigma[i], COULOMB),
            fischer_burmeister(
                (mu[i] * sigma[i] * ri[0], sigma[i] * ri[1], sigma[i] * ri[2]),
                (y[0], mu[i] * y[1], mu[i] * y[2]),
            ),
        )
        for k in range(3):
            e = maps[k]
            squares[k] += e[0] * e[0] + e[1] * e[1] + e[2] * e[2]


def measure(problem: IncrementalProblem, r: Array, facets: int = COULOMB) -> Measure:
    """Measure the impulse `r` (3n,) by the law with `facets` facets.

    An `r` that is not finite, or whose squares or those of `u` are not, gives infinities.

    >>> from scipy.sparse import eye_array
    >>> problem = IncrementalProblem.from_sparse(eye_array(3), np.array([-1.0, 0.0, 0.0]), np.array([0.5]))
    >>> measure(problem, np.array([1.0, 0.0, 0.0])).residual
    0.0
    """
    if r.shape != (3 * problem.n,):
        raise ValueError(f"r must have shape ({3 * problem.n},), not {r.shape}")
    with np.errstate(over="ignore", invalid="ignore"):
        u = problem.W @ r + problem.b
        if not np.isfinite(np.square(r).sum() + np.square(u).sum()):
            return Measure(*[math.inf] * 8)
        squares = np.zeros(3)
        _sums(u, np.ascontiguousarray(r), problem.mu, problem.sigma, facets, squares)
        squares[np.isnan(squares)] = math.inf
        law, coulomb, fb = (relative(math.sqrt(q / max(1, problem.n)), problem.b_ref) for q in squares)
        return Measure(law, coulomb, fb, *_defects(u.reshape(-1, 3), r.reshape(-1, 3), problem.mu))


def _defects(u: Array, r: Array, mu: Array) -> tuple[float, float, float, float, float]:
    """Physical defects as maxima over the contacts: never sums, which would cancel."""
    if len(mu) == 0:
        return 0.0, 0.0, 0.0, 0.0, 0.0
    r_T, u_T = np.linalg.norm(r[:, 1:], axis=1), np.linalg.norm(u[:, 1:], axis=1)
    excess = np.where(mu * r_T <= -r[:, 0], np.hypot(r[:, 0], r_T), (r_T - mu * r[:, 0]) / np.hypot(1.0, mu))
    work = np.einsum("ij,ij->i", u[:, 1:], r[:, 1:])
    slips = (r_T > 0.999 * mu * r[:, 0]) & (r_T > 0) & (u_T > 1e-6 * max(float(u_T.max()), 1e-300))
    cross = np.abs(u[:, 1] * r[:, 2] - u[:, 2] * r[:, 1])
    angle = np.where(slips, np.arctan2(cross, -work), 0.0)
    return (
        float(np.maximum(-u[:, 0], 0.0).max()),
        float(np.maximum(excess, 0.0).max()),
        float(np.abs(u[:, 0] * r[:, 0]).max()),
        float(np.maximum(work, 0.0).max()),
        float(angle.max()),
    )
