"""Super-Clothoid [Casati 2013]: the curvature is linear in an element and continuous along the rod.

This file holds all that is special to the basis: the hat functions `phi` of an element and the transport of
frame and centreline along it. Coefficient `e + a` belongs to shape `a` of element `e`, so it is the curvature
at node `e + a`.

The frame has no closed form but an entire power series. Over a part of length h with the curvatures
`kappa = (alpha + xi beta)/h`, `0 ≤ xi ≤ 1`, the ODE `F' = h F [kappa]×` and `r' = h F e_1` give

    (n + 1) F_{n+1} = F_n [alpha]× + F_{n−1} [beta]×,     F(1) = Σ F_n,     r(1) = r(0) + h Σ F_n e_1/(n + 1)

Error. `‖F_n‖ ≤ m_n`, where `m_n` are the coefficients of `exp(|alpha| xi + |beta| xi²/2)`: the same recurrence
in numbers. The sum ends at the first n with `m_n, m_{n−1} ≤ TAIL`. Then `2 (|alpha| + |beta|) < n`, every later
pair of terms is at most half the pair before, and what is left out is below `2 TAIL = 1.1e-16`. Parts turn by
`STEP` at most (`|alpha| ≤ STEP`, `|beta| ≤ 2 STEP`), so at most `TERMS` terms are needed, and rounding
grows by `exp(|alpha| + |beta|/2) ≤ 21` at most, for a curvature that reverses inside the part, and mostly by
less than 5. An element that turns by θ has `1 + θ/STEP` parts, whose errors add up: 1e-14 after ten turns.
"""

import numpy as np
from numpy.typing import NDArray

from fibercontact.jit import jit, jit_lean
from fibercontact.rods.vectors import Vector, along, cross, norm, row, scaled

__all__ = ["SHAPES", "shape", "transport"]

Array = NDArray[np.float64]

SHAPES = 2  # functions phi that are not zero in an element
STEP = 1.5  # rad, the most a part turns by
MOST = 1e6  # rad, the most an element may turn by; the frame is NaN beyond
TAIL = 2.0**-54
TERMS = 48
_INVERSE = 1 / np.arange(1.0, TERMS + 2)


@jit
def shape(a: int, xi: float) -> float:
    """Value of the element's shape function `a` at `xi` in [0, 1]: one at its end `a`, zero at the other."""
    return xi if a == 1 else 1 - xi


@jit_lean
def transport(
    coefficients: Array,
    length: float,
    places: Array,
    frame: Array,
    position: Array,
    frames: Array,
    positions: Array,
) -> None:
    """Carry frame and position from the start of an element to its ascending `places` (m,), in [0, 1].

    coefficients (SHAPES, 3): curvatures `(tau, kappa_1, kappa_2)` at the ends of the element, rad/m. length: of
    the element, m. frame (3, 3): columns `t, n_1, n_2`. The start may be kept at the end of the outputs, frames
    (m, 3, 3) and positions (m, 3). They are NaN where a curvature is not finite or absurd.
    """
    first, slope = row(coefficients[0]), along(row(coefficients[1]), -1.0, row(coefficients[0]))
    X, Y, Z, r = row(frame[0]), row(frame[1]), row(frame[2]), row(position)
    begin = 0.0
    for k in range(len(places)):
        kappa, change = along(first, begin, slope), scaled(places[k] - begin, slope)
        X, Y, Z, r = _span(kappa, change, (places[k] - begin) * length, X, Y, Z, r)
        begin = places[k]
        for c in range(3):
            frames[k, 0, c], frames[k, 1, c], frames[k, 2, c] = X[c], Y[c], Z[c]
            positions[k, c] = r[c]


@jit
def _span(
    kappa: Vector, change: Vector, x: float, X: Vector, Y: Vector, Z: Vector, r: Vector
) -> tuple[Vector, Vector, Vector, Vector]:
    """Carry the rows X, Y, Z of the frame and the position r over the length x, cut in parts.

    The curvature goes from `kappa` to `kappa + change`.
    """
    angle = x * max(norm(kappa), norm(along(kappa, 1.0, change)))
    parts = 1 + int(angle / STEP) if angle < MOST else 1
    h = x / parts if angle < MOST else np.nan
    for part in range(parts):
        alpha = scaled(h, along(kappa, part / parts, change))
        X, Y, Z, mean = _turn(alpha, scaled(h / parts, change), X, Y, Z)
        r = along(r, h, mean)
    return X, Y, Z, r


@jit
def _turn(
    alpha: Vector, beta: Vector, X: Vector, Y: Vector, Z: Vector
) -> tuple[Vector, Vector, Vector, Vector]:
    """Sum the series of a part: its last frame from its first, row by row, and the mean of its tangents."""
    a, b, m, before = norm(alpha), norm(beta), 1.0, 0.0
    X_end, Y_end, Z_end, mean = X, Y, Z, (X[0], Y[0], Z[0])
    X_before = Y_before = Z_before = (0.0, 0.0, 0.0)
    for n in range(TERMS):
        X, X_before = _next(n, X, X_before, alpha, beta), X
        Y, Y_before = _next(n, Y, Y_before, alpha, beta), Y
        Z, Z_before = _next(n, Z, Z_before, alpha, beta), Z
        X_end, Y_end, Z_end = along(X_end, 1.0, X), along(Y_end, 1.0, Y), along(Z_end, 1.0, Z)
        mean = along(mean, _INVERSE[n + 1], (X[0], Y[0], Z[0]))
        m, before = (a * m + b * before) * _INVERSE[n], m
        if max(m, before) <= TAIL:
            break
    return X_end, Y_end, Z_end, mean


@jit
def _next(n: int, term: Vector, before: Vector, alpha: Vector, beta: Vector) -> Vector:
    """Term n + 1 of the series of a row of the frame: a row times `[k]×` is its cross product with k."""
    return scaled(_INVERSE[n], along(cross(term, alpha), 1.0, cross(before, beta)))
