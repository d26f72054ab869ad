"""Linearised cone: Coulomb's disc replaced by a regular polygon; exact for that law.

Equation: the linear complementarity problem of one contact whose impulses lie in the pyramid over a regular
polygon with `facets` vertices on the circle of radius `mu r_N`; it is solved by going through its
complementary faces: take-off, stick, and the slips along each facet or at each vertex of the polygon.
Reference: Stewart and Trinkle, IJNME 39, 1996; Anitescu and Potra, Nonlinear Dynamics 14, 1997.
Judged against its own law; its answers differ from Coulomb's by the model error, largest for few facets.
"""

import math

import numpy as np
from numpy.typing import NDArray

from fibercontact.jit import jit
from fibercontact.local.algebra import affine, eliminate_normal, is_finite, meets, stick_impulse
from fibercontact.local.contract import HONEST, LocalSolver, Matrix, Option, Status
from fibercontact.problem.cone import Vector, natural_map, norm, project_pyramid

__all__ = ["solver"]


@jit
def facet_slip(W: Matrix, b: Vector, mu: float, angle: float, half: float) -> Vector:
    """Impulse on the facet with outward normal at `angle`, sliding freely along it: `u_N = u_along = 0`."""
    c, s = math.cos(angle), math.sin(angle)
    apothem = mu * math.cos(half)
    W_No, W_Na = c * W[0][1] + s * W[0][2], c * W[0][2] - s * W[0][1]  # outward, along
    W_ao = c * s * (W[2][2] - W[1][1]) + (c * c - s * s) * W[1][2]
    W_aa = c * c * W[2][2] + s * s * W[1][1] - 2.0 * c * s * W[1][2]
    a, d = W[0][0] + apothem * W_No, W_Na + apothem * W_ao
    det = a * W_aa - W_Na * d
    b_a = c * b[2] - s * b[1]
    normal = (W_Na * b_a - W_aa * b[0]) / det
    along = (d * b[0] - a * b_a) / det
    out = apothem * normal
    return (normal, c * out - s * along, s * out + c * along)


@jit
def vertex_slip(W: Matrix, b: Vector, mu: float, angle: float) -> Vector:
    """Impulse on the edge of the pyramid over the vertex at `angle`: `u_N = 0`."""
    c, s = mu * math.cos(angle), mu * math.sin(angle)
    normal = -b[0] / (W[0][0] + c * W[0][1] + s * W[0][2])
    return (normal, c * normal, s * normal)


@jit
def face_residual(W: Matrix, b: Vector, mu: float, facets: int, r: Vector) -> float:
    """Norm of the pyramid's natural map at `r`; infinite outside the half-space of impulses, and at infinity."""
    if not 0.0 <= r[0] < math.inf:
        return math.inf
    sigma = (W[0][0] + W[1][1] + W[2][2]) / 3.0
    return norm(natural_map(affine(W, r, b), r, mu, sigma, facets))


@jit
def kernel(
    W: Matrix, b: Vector, mu: float, r: Vector, options: NDArray[np.float64]
) -> tuple[int, Vector, int]:
    """Solve one contact; see the module's docstring."""
    if not is_finite(W, b, mu):
        return Status.NOT_FINITE, r, 0
    facets = int(options[0])
    if b[0] >= 0.0:
        return Status.CONVERGED, (0.0, 0.0, 0.0), 0
    if mu <= 0.0:
        return Status.CONVERGED, (-b[0] / W[0][0], 0.0, 0.0), 0
    stops, best = stick_impulse(eliminate_normal(W, b), b)
    if stops and project_pyramid(best, mu, facets) == best:
        return Status.CONVERGED, best, 0
    least = math.inf
    half = math.pi / facets
    for k in range(2 * facets):
        angle = k * half
        trial = vertex_slip(W, b, mu, angle) if k % 2 == 0 else facet_slip(W, b, mu, angle, half)
        residual = face_residual(W, b, mu, facets, trial)
        if residual < least:
            best, least = trial, residual
            if least <= 1e-12 * norm(b):
                break
    if math.isinf(least):
        return Status.NO_ROOT, r, 0
    return (Status.CONVERGED if meets(W, b, mu, best, least, HONEST) else Status.INACCURATE), best, 0


solver = LocalSolver(kernel, options={"facets": Option(4, "vertices of the polygon")}, facets="facets")
