"""The modified Fischer–Burmeister function of one contact, its Jacobian, and Newton's method on it."""

import math

import numpy as np
from numpy.typing import NDArray

from fibercontact.jit import jit
from fibercontact.local.algebra import affine
from fibercontact.local.contract import Matrix
from fibercontact.local.newton import Contact, newton
from fibercontact.problem.cone import Vector, smaller_root

__all__ = ["mfb", "modified_fischer_burmeister"]

BOUNDARY = 3e-8
"""Least ratio of the two spectral values of z in the Jacobian: `L_z` is singular on the boundary of the cone."""


@jit
def arrow_solve(z: Vector, det: float, x: Vector) -> Vector:
    """`L_z⁻¹ x` for the arrow matrix `L_z = [[z0, z̄ᵀ], [z̄, z0 I]]`, with `det = z0² - |z̄|²`."""
    s = (z[0] * x[0] - z[1] * x[1] - z[2] * x[2]) / det
    return (s, (x[1] - s * z[1]) / z[0], (x[2] - s * z[2]) / z[0])


@jit
def modified_fischer_burmeister(c: Contact, r: Vector) -> tuple[Vector, Matrix]:
    """`(f, df/dr)` of `f = x + y - (x∘x + y∘y)^(1/2)`, `x = (mu r_N, r_T)`, `y = (ũ_N, mu u_T)`.

    `df/dx = I - L_z⁻¹ L_x`, `df/dy = I - L_z⁻¹ L_y`, chained through `ũ_N = u_N + mu |u_T|`; at `u_T = 0` the
    derivative of `|u_T|` is taken as 0, an element of its subdifferential.
    Reference: Daviet, Bertails-Descoubes and Boissieux, ACM TOG 30(6), 2011; THEORY §3.
    """
    W, mu = c.W, c.mu
    u = affine(W, r, c.b)
    speed = math.sqrt(u[1] * u[1] + u[2] * u[2])
    e1, e2 = (mu * u[1] / speed, mu * u[2] / speed) if speed > 0.0 else (0.0, 0.0)
    x = (mu * r[0], r[1], r[2])
    y = (u[0] + mu * speed, mu * u[1], mu * u[2])
    head = x[0] * x[0] + x[1] * x[1] + x[2] * x[2] + y[0] * y[0] + y[1] * y[1] + y[2] * y[2]
    if head == 0.0:  # the corner of the function: any element of its generalised Jacobian
        return (0.0, 0.0, 0.0), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    v1, v2 = 2.0 * (x[0] * x[1] + y[0] * y[1]), 2.0 * (x[0] * x[2] + y[0] * y[2])
    tail = math.sqrt(v1 * v1 + v2 * v2)
    low, high = smaller_root(x, y, head, tail), math.sqrt(head + tail)
    scale = 0.5 * (high - low) / tail if tail > 0.0 else 0.0
    z = (0.5 * (low + high), scale * v1, scale * v2)
    f = (x[0] + y[0] - z[0], x[1] + y[1] - z[1], x[2] + y[2] - z[2])
    det = max(low, BOUNDARY * high) * high
    # Columns of L_x X + L_y Y with X = diag(mu, 1, 1) and Y = dy/dr
    columns = (
        velocity_column(W, mu, e1, e2, y, 0, (mu * x[0], mu * x[1], mu * x[2])),
        velocity_column(W, mu, e1, e2, y, 1, (x[1], x[0], 0.0)),
        velocity_column(W, mu, e1, e2, y, 2, (x[2], 0.0, x[0])),
    )
    g0 = arrow_solve(z, det, columns[0])
    g1 = arrow_solve(z, det, columns[1])
    g2 = arrow_solve(z, det, columns[2])
    n0 = W[0][0] + e1 * W[1][0] + e2 * W[2][0]
    n1 = W[0][1] + e1 * W[1][1] + e2 * W[2][1]
    n2 = W[0][2] + e1 * W[1][2] + e2 * W[2][2]
    J = (
        (mu + n0 - g0[0], n1 - g1[0], n2 - g2[0]),
        (mu * W[1][0] - g0[1], 1.0 + mu * W[1][1] - g1[1], mu * W[1][2] - g2[1]),
        (mu * W[2][0] - g0[2], mu * W[2][1] - g1[2], 1.0 + mu * W[2][2] - g2[2]),
    )
    return f, J


@jit
def velocity_column(W: Matrix, mu: float, e1: float, e2: float, y: Vector, j: int, start: Vector) -> Vector:
    """`start + L_y dy/dr_j`, with `dy/dr_j = (W_Nj + mu e·W_Tj, mu W_Tj)`."""
    d0 = W[0][j] + e1 * W[1][j] + e2 * W[2][j]
    d1, d2 = mu * W[1][j], mu * W[2][j]
    return (
        start[0] + y[0] * d0 + y[1] * d1 + y[2] * d2,
        start[1] + y[1] * d0 + y[0] * d1,
        start[2] + y[2] * d0 + y[0] * d2,
    )


@jit
def mfb(W: Matrix, b: Vector, mu: float, r: Vector, options: NDArray[np.float64]) -> tuple[int, Vector, int]:
    """Damped Newton on the modified Fischer–Burmeister function, with the options of `newton`."""
    return newton(modified_fischer_burmeister, W, b, mu, r, options[0], int(options[1]), True, 1.0, 0.0)
