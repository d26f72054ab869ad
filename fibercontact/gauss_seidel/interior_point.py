"""An interior-point method on Coulomb's law itself: a start for sweeps that stall.

With `s_i = sqrt(sigma_i)`, `x_i = s_i (mu r_N, r_T)` and `y_i = (ũ_N / mu, ũ_T) / s_i`, both in the Lorentz cone L,

    y − ‖y_T‖ e = A x + c,    x ∈ L,  y ∈ L,  x∘y = 0,

`A` and `c` being `W` and `b` in these variables: the slip term that makes the law non-associated stands on the left,
as a function of `y`, and is differentiated like the rest. Newton's method on the perturbed law `x∘y = t e` with the
scaling of Nesterov and Todd, `Θ² dx + dy = q`, leaves one sparse system an iteration, `(A + G Θ²) dx = G q − rho`
with `G = I − e (0, y_T/‖y_T‖)ᵀ`: the matrix of `W` but for its 3×3 diagonal blocks. Predictor and corrector are
Mehrotra's. A contact without friction keeps its normal components alone, a cone of one dimension.

No theorem says that this converges, for the law is no optimality condition. It is judged by the residual of its
impulses; rounding leaves 1e-6 to 1e-10 of it, which is for a few sweeps to remove.

References: Nesterov and Todd, SIAM J. Optim. 8, 1998; Mehrotra, SIAM J. Optim. 2, 1992; Acary, Cadoux, Lemaréchal and
Malick, ZAMM 91, 2011, for the law as a cone complementarity problem; THEORY §1, §2.
"""

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from fibercontact.gauss_seidel.blocks import BlockSystem, matrix, residual_from, velocity
from fibercontact.problem.cone import COULOMB

__all__ = ["InteriorRun", "interior_point"]

Array = NDArray[np.float64]

PATIENCE = 12
"""Iterations without a new least residual after which the method stops."""
SHORTEST = 1e-8
"""Step, as a share of Newton's, below which it stops."""
TO_BOUNDARY = 0.7
"""Share of the way to the boundary of the cones that a step goes at most.

Nearer to it, at 0.9 to 0.99 as is usual for convex problems, the method comes to a halt far from the solution on
about one jammed problem in eight; at 0.7 on none of those tried, for a sixth more iterations.
"""
REGULARISATION = 1e-13
"""Added to the diagonal of `A`, whose entries are near 1: `W` is often singular."""
MINUS = np.array([1.0, -1.0, -1.0])  # diagonal of the reflection J
TINY = 1e-300


class InteriorRun(NamedTuple):
    """The best impulses `r` (3n,) in N·s, their residual in the unit of b, and the iterations done."""

    r: Array
    residual: float
    iterations: int


class _Cones(NamedTuple):
    """The problem in the variables of the cones, which are of the order of 1."""

    A: csc_array  # (3n, 3n)
    diagonal: NDArray[np.int64]  # (n, 3, 3) places of the diagonal blocks in A.data
    c: Array  # (n, 3)
    impulse: Array  # (n, 3): r = impulse * x


class _Scaling(NamedTuple):
    """Scaling of Nesterov and Todd, `Θ x = Θ⁻¹ y = point`, and `G Θ²`; all (n, 3, 3) but the point (n, 3)."""

    theta: Array
    inverse: Array
    point: Array
    G: Array


def interior_point(
    system: BlockSystem, b_ref: float, tolerance: float, max_iterations: int = 250, deadline: float = np.inf
) -> InteriorRun:
    """Solve by Coulomb's law until the residual is `tolerance`, in the unit of b, or no progress is made.

    `b_ref` is the size of b that impulses are scaled by. It also stops when the clock, `time.perf_counter`, has
    passed the `deadline`.
    """
    cones = _in_cones(system, b_ref)
    x, y = _start(cones)
    u, best, since, k = np.empty(x.size), InteriorRun(np.zeros(x.size), np.inf, 0), 0, 0
    with np.errstate(all="ignore"):  # what is not finite ends the loop
        for k in range(1, max_iterations + 1):
            step = _newton_step(cones, x, y)
            if step is None:
                break
            x, y = x + step[0], y + step[1]
            r = np.ravel(cones.impulse * x)
            velocity(system, r, u)
            residual = residual_from(system, r, u, COULOMB)
            best, since = (InteriorRun(r, residual, k), 0) if residual < best.residual else (best, since + 1)
            if best.residual <= tolerance or since >= PATIENCE or time.perf_counter() > deadline:
                break
    return best._replace(iterations=k)


def _in_cones(system: BlockSystem, b_ref: float) -> _Cones:
    """Change the variables; tangential rows and columns of contacts without friction are dropped."""
    n, slides = len(system.mu), system.mu > 0.0
    s, unit = np.sqrt(system.sigma), b_ref / np.sqrt(np.mean(system.sigma))
    kept = np.column_stack([1.0 / np.where(slides, system.mu, 1.0), slides, slides]) / s[:, None]
    W = matrix(system, system.blocks)
    row, indices, indptr = np.repeat(np.arange(3 * n), np.diff(W.indptr)), W.indices, W.indptr
    factor = np.ravel(kept)
    data = W.data * factor[row] * factor[indices]
    diagonal = np.flatnonzero(row // 3 == indices // 3).reshape(n, 3, 3)
    data[diagonal[:, [0, 1, 2], [0, 1, 2]]] += REGULARISATION
    A = csc_array((data, indices, indptr), shape=(3 * n, 3 * n))
    return _Cones(A, diagonal, kept * np.reshape(system.b, (n, 3)) / unit, kept * unit)


def _start(cones: _Cones) -> tuple[Array, Array]:
    """Impulses along the normals, and the velocities that they leave, moved into the cones."""
    x = np.zeros_like(cones.c)
    x[:, 0] = 1.0
    y = _apply(cones, x) + cones.c
    y[:, 0] = np.maximum(y[:, 0] + _tangential(y), _tangential(y) + 1.0)
    return x, y


def _apply(cones: _Cones, x: Array) -> Array:
    return np.reshape(cones.A @ x.ravel(), x.shape)


def _tangential(x: Array) -> Array:
    """`‖x_T‖`, (n,)."""
    return np.hypot(x[:, 1], x[:, 2])


def _times(blocks: Array, x: Array) -> Array:
    """Block by block product of (n, 3, 3) and (n, 3)."""
    return np.einsum("nij,nj->ni", blocks, x)


def _arrow(x: Array) -> Array:
    """The matrices (n, 3, 3) of the Jordan product with x: `x∘y = arrow(x) y`."""
    arrow = x[:, 0, None, None] * np.eye(3)
    arrow[:, 0, 1:] = arrow[:, 1:, 0] = x[:, 1:]
    return arrow


def _quotient(z: Array, x: Array) -> Array:
    """The `y` with `x∘y = z`."""
    y = np.empty_like(z)
    y[:, 0] = (x[:, 0] * z[:, 0] - np.sum(x[:, 1:] * z[:, 1:], axis=1)) / (x[:, 0] ** 2 - _tangential(x) ** 2)
    y[:, 1:] = (z[:, 1:] - y[:, :1] * x[:, 1:]) / x[:, :1]
    return y


def _newton_step(cones: _Cones, x: Array, y: Array) -> tuple[Array, Array] | None:
    """Mehrotra's predictor and corrector from (x, y), damped; None when no step can be made."""
    scaling, gap = _scale(x, y), np.sum(x * y) / len(x)
    slip = y.copy()
    slip[:, 0] -= _tangential(y)
    solve = _factor(cones, scaling, _apply(cones, x) + cones.c - slip)
    if solve is None:
        return None
    square = _times(_arrow(scaling.point), scaling.point)
    dx, dy = solve(-square)
    share = min(1.0, _longest(x, dx), _longest(y, dy))
    left = np.sum((x + share * dx) * (y + share * dy)) / len(x) / gap
    second = _times(_arrow(_times(scaling.theta, dx)), _times(scaling.inverse, dy))
    target = -square - second
    target[:, 0] += max(min(left, 1.0), 0.01) ** 3 * gap
    dx, dy = solve(target)
    share = min(1.0, TO_BOUNDARY * _longest(x, dx), TO_BOUNDARY * _longest(y, dy))
    if not (share > SHORTEST and np.isfinite(dx).all() and np.isfinite(dy).all()):
        return None
    return share * dx, share * dy


def _scale(x: Array, y: Array) -> _Scaling:
    """The scaling at a point inside the cones, in closed form for the Lorentz cone."""
    size_x, size_y = (np.sqrt(np.maximum(z[:, 0] ** 2 - _tangential(z) ** 2, TINY)) for z in (x, y))
    unit_x, unit_y = x / size_x[:, None], y / size_y[:, None]
    w = unit_y + MINUS * unit_x
    w /= np.sqrt(2.0 * (1.0 + np.sum(unit_x * unit_y, axis=1)))[:, None]
    root = np.sqrt(size_y / size_x)[:, None, None]
    boost = _arrow(w)
    boost[:, 1:, 1:] = np.eye(2) + w[:, 1:, None] * w[:, None, 1:] / (1.0 + w[:, 0])[:, None, None]
    theta, inverse = root * boost, (MINUS[:, None] * MINUS) * boost / root
    G = np.tile(np.eye(3), (len(x), 1, 1))
    G[:, 0, 1:] -= y[:, 1:] / np.maximum(_tangential(y), TINY)[:, None]
    return _Scaling(theta, inverse, _times(theta, x), G)


def _factor(cones: _Cones, scaling: _Scaling, rho: Array) -> Callable[[Array], tuple[Array, Array]] | None:
    """What solves `y − ‖y_T‖ e = A x + c` and `point ∘ (Θ dx + Θ⁻¹ dy) = target`, linearised, for (dx, dy)."""
    square = np.matmul(scaling.theta, scaling.theta, dtype=np.float64)
    blocks = scaling.G @ square
    data = cones.A.data.copy()
    data[cones.diagonal] += blocks.transpose(0, 2, 1)  # the columns of A are stored
    if not np.isfinite(data).all():
        return None
    matrix = csc_array((data, cones.A.indices, cones.A.indptr), shape=cones.A.shape)
    try:
        # Pivots on the diagonal, in an order for symmetric structure: A is semidefinite, G Θ² small or definite.
        factor = splu(
            matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.1, options={"SymmetricMode": True}
        )
    except RuntimeError:  # singular
        return None

    def solve(target: Array) -> tuple[Array, Array]:
        q = _times(scaling.theta, _quotient(target, scaling.point))
        dx = np.reshape(factor.solve(np.ravel(_times(scaling.G, q) - rho)), q.shape)
        return dx, q - _times(square, dx)

    return solve


def _longest(x: Array, dx: Array) -> float:
    """The largest step for which all of `x + step dx` stay in the Lorentz cone, infinite if they always do."""
    a, b, c = (
        p[:, 0] * q[:, 0] - p[:, 1] * q[:, 1] - p[:, 2] * q[:, 2] for p, q in ((dx, dx), (x, dx), (x, x))
    )
    root = np.sqrt(np.maximum(b * b - a * c, 0.0))  # never negative but for rounding, since x is inside
    q = -(b + np.copysign(root, b))
    steps = np.concatenate([q / a, c / q])
    return float(np.min(steps[steps > 0.0], initial=np.inf))
