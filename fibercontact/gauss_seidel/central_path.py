"""The central path to Coulomb's law, followed round its turns.

The path is the solutions of

    y − (1 − lam) ‖y_T‖ e = A x + c + lam d,    x ∈ L,  y ∈ L,  x∘y = lam e

with L the product of Lorentz cones; at its end, `lam = 0`, they are Coulomb's law in the variables of
`interior_point`. At `lam = 1` the slip term `‖y_T‖ e`, which makes the law non-associated, is absent: that problem is
convex, and `d` is such that its one solution is `x = e`, `y = e`, where the path starts, or multiples of these.

*It turns.* The law is no optimality condition, so lam need not fall all the way: on jammed problems the path folds,
and a method that only lets lam fall comes to a halt there. It is followed by arclength instead. With the scaling of
Nesterov and Todd, `Θ² dx + dy = q`, Newton's equations are `(A + G Θ²) dx = G q − rho` with
`G = I − (1 − lam) e (0, y_T/‖y_T‖)ᵀ`, a matrix with the pattern of `A`. One factorisation gives the tangent, Newton's
correction orthogonal to it, and the curvature of both. *Ahead* is where lam falls if the determinant is positive, and
where it rises if it is negative. Followed so, the path cannot come back to `lam = 1`. It is bounded if
`b + W z ∈ int K_mu*` for some z (THEORY §5), and then ends in a solution for almost all data.

References: Allgower and Georg, Numerical Continuation Methods, 1990, chapters 2, 6 and 11; Nesterov and Todd, SIAM J.
Optim. 8, 1998; Mehrotra, SIAM J. Optim. 2, 1992, for the curvature.
"""

from collections.abc import Iterator
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, csr_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import SuperLU, splu

from fibercontact.gauss_seidel.lorentz import (
    Scaling,
    arrow,
    eigenvalues,
    inside,
    quotient,
    scaling,
    tangential,
    times,
)

__all__ = ["Equations", "Point", "walk"]

Array = NDArray[np.float64]

NEAR, NEARER = 0.5, 0.02
"""Distance at which a point counts as on the path: at first, and once the path has been lost."""
FAR = 10.0
"""Distance to which a step ahead may lead."""
CORRECTIONS = 5
"""Corrections after which the path is lost."""
LONGEST, SHORTEST = 0.995, 1e-9
"""Steps ahead, as shares of the way to `lam = 0` by the tangent."""
ROUNDING = 1e-14
"""lam at which a path that is lost is lost to rounding."""
TINY = 1e-300


class Equations(NamedTuple):
    """`A`, symmetric, positive semidefinite, and `c`; numbers of the order of 1."""

    A: csc_array  # (3n, 3n)
    diagonal: NDArray[np.int64]  # (n, 3, 3) places of the diagonal blocks in A.data
    c: Array  # (n, 3)


class Point(NamedTuple):
    """A point inside the cones; or a change of one, `lam` being relative then."""

    x: Array  # (n, 3)
    y: Array  # (n, 3)
    lam: float


class _Layout(NamedTuple):
    """The matrix of Newton's equations in the order that fills in least, sought once."""

    order: NDArray[np.int32]  # (3n,) row of A that comes there
    places: NDArray[np.int64]  # of the numbers in A.data
    indices: NDArray[np.int32]
    indptr: NDArray[np.int32]


class _Newton(NamedTuple):
    """Newton's equations at a point, factorised."""

    at: Point
    scale: Scaling
    G: Array  # (n, 3, 3)
    order: NDArray[np.int32]
    factor: SuperLU


class _Chart(NamedTuple):
    """The path near a point: two curves from there, back to the path, and ahead. The bends are their curvatures."""

    at: Point
    scale: Scaling
    distance: float  # square of the largest correction of a contact
    back: Point
    back_bend: Point
    ahead: Point
    ahead_bend: Point


def walk(equations: Equations, start: float = 1.0) -> Iterator[Point]:
    """Points on the path or near it, as long as it can be followed; one factorisation between two of them.

    It starts at `x = start e`, `y = e / start`, for which d is chosen: other starts are other paths.
    """
    e = np.zeros_like(equations.c)
    e[:, 0] = 1.0
    d = e / start - _apply(equations, start * e) - equations.c
    layout = _layout(equations)
    point: Point | None = Point(start * e, e / start, 1.0)
    near, step, corrections = NEAR, 1.0, 0
    base: _Chart | None = None
    anchor: _Chart | None = None
    while point is not None:
        yield point
        chart = _chart(equations, layout, d, point)
        if chart is None:
            return
        if chart.distance > near and corrections < CORRECTIONS:
            corrections += 1
            point = _corrected(chart)
            if point is not None:
                continue
        if chart.distance <= near and (base is None or _progress(base, chart.at) > 0.0):
            step *= 3.0 if corrections <= 1 else 1.0 if corrections <= 2 else 0.5
            base, step, corrections = chart, min(step, 1.0), 0
            anchor = chart if chart.distance <= NEARER else anchor
        elif chart.at.lam < ROUNDING:
            return
        else:  # the path is lost
            base, near, step, corrections = anchor, NEARER, 0.2 * step, 0
        point, step = _stepped(base, step) if base is not None else (None, step)


def _apply(equations: Equations, x: Array) -> Array:
    return np.reshape(equations.A @ x.ravel(), x.shape)


def _distances(p: Point) -> Array:
    """How far from `x∘y = lam e` each eigenvalue is, (2, n): zero there, growing towards both boundaries."""
    share = eigenvalues(p.x, p.y) / p.lam
    return share - 1.0 - np.log(share)


def _chart(equations: Equations, layout: _Layout, d: Array, at: Point) -> _Chart | None:
    """The path near a point; None where Newton's equations cannot be solved."""
    newton = _newton(equations, layout, at)
    if newton is None:
        return None
    slip, z = np.zeros_like(d), newton.scale.point
    slip[:, 0] = tangential(at.y)
    lam_e = np.zeros_like(d)
    lam_e[:, 0] = at.lam
    rho = _apply(equations, at.x) + equations.c + at.lam * d - at.y + (1.0 - at.lam) * slip
    back = Point(*_solve(newton, rho, lam_e - times(arrow(z), z)), 0.0)
    falling = Point(*_solve(newton, at.lam * (slip - d), -lam_e), -1.0)
    sign = _orientation(newton.factor)
    ahead = _scaled(sign, falling)
    back = _across(newton, ahead, back)
    return _Chart(
        at,
        newton.scale,
        float(np.max(np.sum(_local(at, newton.scale, back) ** 2, axis=1))),
        back,
        _across(newton, ahead, _bend(newton, back)),
        ahead,
        _across(newton, ahead, _bend(newton, ahead)),
    )


def _layout(equations: Equations) -> _Layout:
    A, data = equations.A, equations.A.data.copy()
    data[equations.diagonal] += np.eye(3)
    order = np.argsort(_factor(data, A.indices, A.indptr, "MMD_AT_PLUS_A").perm_c).astype(np.int32)
    places = csc_array((np.arange(1, len(data) + 1), A.indices, A.indptr), shape=A.shape)[order][:, order]
    places.sort_indices()
    return _Layout(order, places.data - 1, places.indices, places.indptr)


def _factor(
    data: Array,
    indices: NDArray[np.int32],
    indptr: NDArray[np.int32],
    order: Literal["NATURAL", "MMD_AT_PLUS_A"] = "NATURAL",
) -> SuperLU:
    """Factorise, with pivots on the diagonal where they are good: A is semidefinite, G Θ² small or definite."""
    size = len(indptr) - 1
    matrix = csc_array((data, indices, indptr), shape=(size, size))
    return splu(matrix, permc_spec=order, diag_pivot_thresh=0.1, options={"SymmetricMode": True})


def _newton(equations: Equations, layout: _Layout, at: Point) -> _Newton | None:
    scale = scaling(at.x, at.y)
    G = np.tile(np.eye(3), (len(at.x), 1, 1))
    G[:, 0, 1:] -= (1.0 - at.lam) * at.y[:, 1:] / np.maximum(tangential(at.y), TINY)[:, None]
    data = equations.A.data.copy()
    data[equations.diagonal] += (G @ scale.theta @ scale.theta).transpose(
        0, 2, 1
    )  # the columns of A are stored
    if not np.isfinite(data).all():
        return None
    try:
        factor = _factor(data[layout.places], layout.indices, layout.indptr)
    except RuntimeError:  # singular
        return None
    return _Newton(at, scale, G, layout.order, factor)


def _solve(newton: _Newton, rho: Array, target: Array) -> tuple[Array, Array]:
    """The (dx, dy) with `A dx − G dy = −rho` and `z∘(Θ dx + Θ⁻¹ dy) = target`, `z = Θ x`."""
    theta = newton.scale.theta
    q = times(theta, quotient(target, newton.scale.point))
    found = np.empty(q.size)
    found[newton.order] = newton.factor.solve(np.ravel(times(newton.G, q) - rho)[newton.order])
    dx = found.reshape(q.shape)
    return dx, q - times(theta, times(theta, dx))


def _orientation(factor: SuperLU) -> float:
    """The sign of the determinant: of the permutations, by their cycles, and of the pivots."""
    order = factor.perm_r[np.argsort(factor.perm_c)]
    n = len(order)
    cycles, _ = connected_components(csr_array((np.ones(n), (np.arange(n), order)), shape=(n, n)))
    return (-1.0) ** (n - cycles + np.count_nonzero(factor.U.diagonal() < 0.0))


def _scaled(share: float, p: Point) -> Point:
    return Point(share * p.x, share * p.y, share * p.lam)


def _plus(p: Point, share: float, q: Point) -> Point:
    """The change `p + share q`."""
    return Point(p.x + share * q.x, p.y + share * q.y, p.lam + share * q.lam)


def _local(at: Point, scale: Scaling, change: Point) -> Array:
    """A change in the units of a point, (n, 7)."""
    unit, lam = np.sqrt(at.lam), np.full(len(change.x), change.lam)
    return np.column_stack([times(scale.theta, change.x) / unit, times(scale.inverse, change.y) / unit, lam])


def _across(newton: _Newton, ahead: Point, change: Point) -> Point:
    """The part of a change that is orthogonal to the path."""
    along = _local(newton.at, newton.scale, ahead)
    share = np.sum(along * _local(newton.at, newton.scale, change)) / np.sum(along * along)
    return _plus(change, -share, ahead)


def _progress(base: _Chart, p: Point) -> float:
    """How far ahead of the base a point is: corrections may lead back."""
    change = Point(p.x - base.at.x, p.y - base.at.y, p.lam / base.at.lam - 1.0)
    return float(np.sum(_local(base.at, base.scale, base.ahead) * _local(base.at, base.scale, change)))


def _bend(newton: _Newton, change: Point) -> Point:
    """What to add to a change because the products and the slip term are not linear."""
    rho = np.zeros_like(change.x)
    rho[:, 0] = _slip_curvature(newton.at, change)
    products = times(arrow(times(newton.scale.theta, change.x)), times(newton.scale.inverse, change.y))
    return Point(*_solve(newton, rho, -products), 0.0)


def _slip_curvature(at: Point, change: Point) -> Array:
    """Change of `(1 − lam) ‖y_T‖` less its linear part, (n,), without cancellation where `‖y_T‖` hardly changes."""
    old, new = at.y[:, 1:], change.y[:, 1:]
    before, after = tangential(at.y), tangential(at.y + change.y)
    linear = np.sum(old * new, axis=1) / np.maximum(before, TINY)
    exact = np.sum((2.0 * old + new) * new, axis=1) / np.maximum(before + after, TINY)
    return (1.0 - at.lam * (1.0 + change.lam)) * exact - (1.0 - at.lam) * linear


def _moved(at: Point, change: Point) -> Point | None:
    """The point after a change, None outside the cones."""
    p = Point(at.x + change.x, at.y + change.y, at.lam * (1.0 + change.lam))
    return p if p.lam > 0.0 and inside(p.x) and inside(p.y) else None


def _corrected(chart: _Chart) -> Point | None:
    """A point nearer to the path, None if none is found."""
    distance, share = _distances(chart.at).sum(), 1.0
    while share > 0.01:
        for bend in (share, 0.0):
            curve = _plus(chart.back, bend, chart.back_bend)
            p = _moved(chart.at, _scaled(share, curve))
            if p is not None and _distances(p).sum() < (1.0 - 0.1 * share) * distance:
                return p
        share *= 0.5
    return None


def _stepped(chart: _Chart, step: float) -> tuple[Point | None, float]:
    """The point a step ahead, None if no step leads near enough to the path; and the step, shortened."""
    while step > SHORTEST:
        h = LONGEST * step
        curve = _scaled(h, _plus(chart.ahead, h, chart.ahead_bend))
        moved = [_moved(chart.at, change) for change in (_plus(curve, 1.0, chart.back), curve)]
        found = [(float(_distances(p).max()), p) for p in moved if p is not None]
        distance, nearest = min(found, key=lambda pair: pair[0], default=(np.inf, None))
        if distance <= FAR:
            return nearest, step
        step *= 0.7
    return None, step
