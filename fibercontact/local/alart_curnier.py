"""The Alart–Curnier function of one contact and its case-wise generalised Jacobian."""

import math

from fibercontact.jit import jit
from fibercontact.local.algebra import affine
from fibercontact.local.contract import Matrix, Option
from fibercontact.local.newton import NEWTON_OPTIONS, Contact
from fibercontact.problem.cone import Vector

__all__ = ["ALART_CURNIER_OPTIONS", "alart_curnier", "steps", "with_steps"]

ALART_CURNIER_OPTIONS = NEWTON_OPTIONS | {
    "rho": Option(1.0, "factor of rho_N = 1/W_NN and rho_T = 1/lambda_max(W_TT)"),
    "disc": Option(0.0, "radius of the friction disc: 0 mu max(0, r_N - rho_N u_N), 1 mu max(0, r_N)"),
}


@jit
def steps(W: Matrix, rho: float) -> tuple[float, float]:
    """`rho_N = rho/W_NN` and `rho_T = rho/lambda_max(W_TT)` (THEORY §3)."""
    half = 0.5 * (W[1][1] + W[2][2])
    spread = 0.5 * (W[1][1] - W[2][2])
    return rho / W[0][0], rho / (half + math.sqrt(spread * spread + W[1][2] * W[1][2]))


@jit
def alart_curnier(c: Contact, r: Vector) -> tuple[Vector, Matrix]:
    """`(f, df/dr)`: normal complementarity, and `r_T` minus its projection on the friction disc (THEORY §3).

    The radius of the disc is `mu max(0, r_N - rho_N u_N)`, or `mu max(0, r_N)` with `disc = 1`.
    Reference: Alart and Curnier, CMAME 92, 1991.
    """
    rho_N, rho_T = steps(c.W, c.rho)
    return with_steps(c, r, rho_N, rho_T)


@jit
def with_steps(c: Contact, r: Vector, rho_N: float, rho_T: float) -> tuple[Vector, Matrix]:
    """The same function for steps that are given."""
    W, mu = c.W, c.mu
    u = affine(W, r, c.b)
    z_N = r[0] - rho_N * u[0]
    z1, z2 = r[1] - rho_T * u[1], r[2] - rho_T * u[2]
    length = math.sqrt(z1 * z1 + z2 * z2)
    slope = (1.0 - rho_N * W[0][0], -rho_N * W[0][1], -rho_N * W[0][2])  # d z_N / dr
    if c.disc == 0.0:
        radius, dR = mu * max(0.0, z_N), slope
    else:
        radius, dR = mu * max(0.0, r[0]), (1.0, 0.0, 0.0)
    if z_N > 0.0:
        f_N, J_N = rho_N * u[0], (1.0 - slope[0], -slope[1], -slope[2])
    else:
        f_N, J_N = r[0], (1.0, 0.0, 0.0)
    if length <= radius:  # stick
        rows = ((rho_T * W[1][0], rho_T * W[1][1], rho_T * W[1][2]),
                (rho_T * W[2][0], rho_T * W[2][1], rho_T * W[2][2]))  # fmt: skip
        return (f_N, rho_T * u[1], rho_T * u[2]), (J_N, rows[0], rows[1])
    if radius <= 0.0:  # take-off
        return (f_N, r[1], r[2]), (J_N, (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    e1, e2 = z1 / length, z2 / length
    ratio = radius / length
    P11, P12, P22 = ratio * e2 * e2, -ratio * e1 * e2, ratio * e1 * e1  # radius (I - e eᵀ) / length
    D1 = (-rho_T * W[1][0], 1.0 - rho_T * W[1][1], -rho_T * W[1][2])  # d z_T / dr
    D2 = (-rho_T * W[2][0], -rho_T * W[2][1], 1.0 - rho_T * W[2][2])
    J1 = (-mu * e1 * dR[0] - P11 * D1[0] - P12 * D2[0],
          1.0 - mu * e1 * dR[1] - P11 * D1[1] - P12 * D2[1],
          -mu * e1 * dR[2] - P11 * D1[2] - P12 * D2[2])  # fmt: skip
    J2 = (-mu * e2 * dR[0] - P12 * D1[0] - P22 * D2[0],
          -mu * e2 * dR[1] - P12 * D1[1] - P22 * D2[1],
          1.0 - mu * e2 * dR[2] - P12 * D1[2] - P22 * D2[2])  # fmt: skip
    return (f_N, r[1] - radius * e1, r[2] - radius * e2), (J_N, J1, J2)
