"""Super-Helix [Bertails 2006]: the curvature is constant in an element, so every element is an arc of helix.

This file holds all that is special to the basis: the step function `phi` of an element and the transport
of frame and centreline along it. Coefficient `e` belongs to element `e`.
"""

import numpy as np
from numpy.typing import NDArray

from fibercontact.jit import jit, jit_lean
from fibercontact.rods.vectors import Vector, row

__all__ = ["SHAPES", "rotation_series", "shape", "transport"]

Array = NDArray[np.float64]

SHAPES = 1  # functions phi that are not zero in an element


@jit
def shape(a: int, xi: float) -> float:
    """Value of the element's shape function `a` at `xi` in [0, 1]."""
    return 1.0


@jit
def rotation_series(angle2: float) -> tuple[float, float, float]:
    """`sin θ/θ`, `(1 − cos θ)/θ²`, `(θ − sin θ)/θ³` of `angle2 = θ²`, without cancellation near zero."""
    if angle2 < 1e-2:
        a = 1 - angle2 / 6 * (1 - angle2 / 20 * (1 - angle2 / 42 * (1 - angle2 / 72)))
        b = (1 - angle2 / 12 * (1 - angle2 / 30 * (1 - angle2 / 56 * (1 - angle2 / 90)))) / 2
        c = (1 - angle2 / 20 * (1 - angle2 / 42 * (1 - angle2 / 72 * (1 - angle2 / 110)))) / 6
        return a, b, c
    angle = np.sqrt(angle2)
    a = np.sin(angle) / angle
    return a, (1 - np.cos(angle)) / angle2, (1 - a) / angle2


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
    """Carry frame and position from the start of an element to its `places` (m,), in [0, 1].

    coefficients (SHAPES, 3): curvatures `(tau, kappa_1, kappa_2)` of the element, rad/m. length: of the element,
    m. frame (3, 3): columns `t, n_1, n_2`. The start may be kept at the end of the outputs, frames (m, 3, 3) and
    positions (m, 3).
    """
    for k in range(len(places)):
        _follow_arc(row(coefficients[0]), places[k] * length, frame, position, frames[k], positions[k])


@jit_lean
def _follow_arc(
    kappa: Vector, x: float, frame: Array, position: Array, frame_out: Array, position_out: Array
) -> None:
    """Carry frame and position to the arc-length x, in closed form.

    With `k = x kappa` in material axes and `θ = |k|`, Rodrigues' formula gives the frame
    `F exp[k]` and, integrated, the centreline
    `r + x F (e_1 + (1 − cos θ)/θ² k×e_1 + (θ − sin θ)/θ³ k×(k×e_1))`. The outputs may be the inputs.
    """
    k0, k1, k2 = x * kappa[0], x * kappa[1], x * kappa[2]
    angle2 = k0 * k0 + k1 * k1 + k2 * k2
    a, b, c = rotation_series(angle2)
    d = 1 - b * angle2
    s0, s1, s2 = x * (1 - c * (k1 * k1 + k2 * k2)), x * (b * k2 + c * k0 * k1), x * (c * k0 * k2 - b * k1)
    for i in range(3):
        t, n1, n2 = frame[i, 0], frame[i, 1], frame[i, 2]
        along = b * (t * k0 + n1 * k1 + n2 * k2)
        position_out[i] = position[i] + t * s0 + n1 * s1 + n2 * s2
        frame_out[i, 0] = d * t + a * (n1 * k2 - n2 * k1) + along * k0
        frame_out[i, 1] = d * n1 + a * (n2 * k0 - t * k2) + along * k1
        frame_out[i, 2] = d * n2 + a * (t * k1 - n1 * k0) + along * k2
