"""An interior-point method on Coulomb's law itself, for problems on which sweeps stall.

With `s_i = sqrt(sigma_i)`, `x_i = s_i (mu r_N, r_T)` and `y_i = (ũ_N / mu, ũ_T) / s_i`, both in the Lorentz cone L,
Coulomb's law is

    y − ‖y_T‖ e = A x + c,    x ∈ L,  y ∈ L,  x∘y = 0,

`A` and `c` being `W` and `b` in these variables: the end of the path that `central_path` follows. The iterates are
judged by the residual of their impulses alone; rounding leaves 1e-7 to 1e-11 of it, which is for a few sweeps to
remove. A contact without friction keeps its normal components alone, a cone of one dimension.

References: Acary, Cadoux, Lemaréchal and Malick, ZAMM 91, 2011, for the law as a cone complementarity problem; THEORY
§1, §2.
"""

import time
from itertools import islice
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array

from fibercontact.gauss_seidel.blocks import BlockSystem, matrix, residual_from, velocity
from fibercontact.gauss_seidel.central_path import Equations, walk
from fibercontact.problem.cone import COULOMB

__all__ = ["InteriorRun", "interior_point"]

Array = NDArray[np.float64]


PATIENCE, SMALL = 100, 1e-9
"""Iterations without half the residual after which it stops, where lam is small; sweeps are better at the rest."""


STARTS = (1.0, 0.3, 3.0)
"""Starts of the path: where one path is lost at a sharp turn, another need not be."""


class InteriorRun(NamedTuple):
    """The best impulses `r` (3n,) in N·s, their residual in the unit of b, and the iterations done."""

    r: Array
    residual: float
    iterations: int


def interior_point(
    system: BlockSystem, b_ref: float, tolerance: float, max_iterations: int = 1000, deadline: float = np.inf
) -> InteriorRun:
    """Solve by Coulomb's law until the residual is `tolerance`, in the unit of b, or no path can be followed.

    Each start has its share of the iterations that are left. `b_ref` is the size of b that impulses are scaled by.
    It also stops when the clock, `time.perf_counter`, has passed the `deadline`.
    """
    equations, impulse = _in_cones(system, b_ref)
    u, best, since, done = np.empty(impulse.size), InteriorRun(np.zeros(impulse.size), np.inf, 0), 0, 0
    with np.errstate(all="ignore"):  # what is not finite ends a walk
        for number, start in enumerate(STARTS):
            share = -(-(max_iterations - done) // (len(STARTS) - number))
            for k, point in enumerate(islice(walk(equations, start), share + 1)):
                iterations, r = done + k, np.ravel(impulse * point.x)
                velocity(system, r, u)
                residual = residual_from(system, r, u, COULOMB)
                since = 0 if residual < 0.5 * best.residual else since + 1
                best = InteriorRun(r, residual, iterations) if residual < best.residual else best
                stuck = point.lam < SMALL and since >= PATIENCE
                if best.residual <= tolerance or stuck or time.perf_counter() > deadline:
                    return best._replace(iterations=iterations)
            done = iterations
            if point.lam < SMALL:  # rounding has ended the walk, not a turn
                break
    return best._replace(iterations=done)


def _in_cones(system: BlockSystem, b_ref: float) -> tuple[Equations, Array]:
    """Change the variables; the second is (n, 3), `r = impulse * x`.

    Tangential rows and columns of contacts without friction are dropped.
    """
    n, slides = len(system.mu), system.mu > 0.0
    s, unit = np.sqrt(system.sigma), b_ref / np.sqrt(np.mean(system.sigma))
    kept = np.column_stack([1.0 / np.where(slides, system.mu, 1.0), slides, slides]) / s[:, None]
    W = matrix(system, system.blocks)
    row, column, factor = np.repeat(np.arange(3 * n), np.diff(W.indptr)), W.indices, np.ravel(kept)
    data = W.data * factor[row] * factor[column]
    own = row // 3 == column // 3
    used = own | (data != 0.0)
    starts = np.concatenate([[0], np.cumsum(np.bincount(row[used], minlength=3 * n))]).astype(np.int32)
    A = csc_array((data[used], column[used], starts), shape=(3 * n, 3 * n))  # of its columns: A is symmetric
    diagonal = np.flatnonzero(own[used]).reshape(n, 3, 3)
    return Equations(A, diagonal, kept * np.reshape(system.b, (n, 3)) / unit), kept * unit
