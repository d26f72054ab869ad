"""The Coulomb cone, its polygonal substitutes, and the residuals of one contact.

Everything here works on one contact, in scalars and 3-tuples `(N, T1, T2)`, so that sweeps, local solvers and
the harness share one definition. A law is named by its number of facets: 0 is Coulomb's, `m >= 3` the law
linearised on the regular polygon with `m` vertices on the circle of radius `mu r_N` (first vertex on T1).
"""

import math

from fibercontact.jit import jit

__all__ = [
    "COULOMB",
    "Vector",
    "change_of_variable",
    "fischer_burmeister",
    "natural_map",
    "norm",
    "project",
    "project_cone",
    "project_pyramid",
    "smaller_root",
]

Vector = tuple[float, float, float]

COULOMB = 0  # facets of the circular cone


@jit
def norm(x: Vector) -> float:
    """Euclidean norm of a 3-tuple."""
    return math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])


@jit
def project_cone(x: Vector, mu: float) -> Vector:
    """Orthogonal projection of `x` on `K_mu = {|x_T| <= mu x_N}`.

    >>> project_cone((0.0, 1.0, 0.0), 1.0)
    (0.5, 0.5, 0.0)
    """
    tangential = math.sqrt(x[1] * x[1] + x[2] * x[2])
    normal = (x[0] + mu * tangential) / (1.0 + mu * mu)
    scale = mu * normal / (tangential if tangential > 0.0 else 1.0)
    # chosen, not branched to: loops over contacts become vector loops
    inside, apex = tangential <= mu * x[0], mu * tangential <= -x[0]
    normal, scale = (x[0] if inside else normal), (1.0 if inside else scale)
    normal, scale = (0.0 if apex else normal), (0.0 if apex else scale)
    return (normal, scale * x[1], scale * x[2])


@jit
def nearest_facet(x1: float, x2: float, facets: int) -> tuple[float, float]:
    """Cosine and sine of the outward normal of the polygon's facet that faces `(x1, x2)`."""
    sector = 2.0 * math.pi / facets
    angle = (math.floor(math.atan2(x2, x1) / sector) + 0.5) * sector
    return math.cos(angle), math.sin(angle)


@jit
def project_pyramid(x: Vector, mu: float, facets: int) -> Vector:
    """Orthogonal projection of `x` on the pyramid inscribed in `K_mu` with `facets` facets.

    By symmetry the projection lies in the sector of `x_T`, so one facet and one of its edges decide.
    """
    c, s = nearest_facet(x[1], x[2], facets)
    out, along = c * x[1] + s * x[2], c * x[2] - s * x[1]
    apothem = mu * math.cos(math.pi / facets)
    half = mu * math.sin(math.pi / facets)
    if x[0] >= 0.0 and out <= apothem * x[0]:
        return x
    normal = (x[0] + apothem * out) / (1.0 + apothem * apothem)
    if normal > 0.0 and abs(along) <= half * normal:
        out = apothem * normal
    else:
        half = math.copysign(half, along)
        normal = max(0.0, (x[0] + apothem * out + half * along) / (1.0 + mu * mu))
        out, along = apothem * normal, half * normal
    return (normal, c * out - s * along, s * out + c * along)


@jit
def project(x: Vector, mu: float, facets: int) -> Vector:
    """Orthogonal projection of `x` on the cone of admissible impulses of a law."""
    if facets == COULOMB:
        return project_cone(x, mu)
    return project_pyramid(x, mu, facets)


@jit
def change_of_variable(u: Vector, mu: float, facets: int) -> Vector:
    """De Saxcé's `u + mu h(-u_T) e` with `h` the support function of the unit disc, or of the polygon."""
    if facets == COULOMB:
        return (u[0] + mu * math.sqrt(u[1] * u[1] + u[2] * u[2]), u[1], u[2])
    sector = 2.0 * math.pi / facets
    angle = round(math.atan2(-u[2], -u[1]) / sector) * sector
    return (u[0] - mu * (math.cos(angle) * u[1] + math.sin(angle) * u[2]), u[1], u[2])


@jit
def natural_map(u: Vector, r: Vector, mu: float, sigma: float, facets: int) -> Vector:
    """`sigma r - P_K(sigma r - ũ)`: zero exactly when `(u, r)` obeys the law (THEORY §2).

    With `z = sigma r - ũ` it is taken as `ũ + (z - P_K(z))`, so that an impulse of any size hides no velocity.
    """
    y = change_of_variable(u, mu, facets)
    x = (sigma * r[0], sigma * r[1], sigma * r[2])
    z = (x[0] - y[0], x[1] - y[1], x[2] - y[2])
    p = project(z, mu, facets)
    apex = p[0] == 0.0
    e = (y[0] + (z[0] - p[0]), y[1] + (z[1] - p[1]), y[2] + (z[2] - p[2]))
    return (x[0] if apex else e[0], x[1] if apex else e[1], x[2] if apex else e[2])


@jit
def smaller_root(x: Vector, y: Vector, head: float, tail: float) -> float:
    """`sqrt(head - tail)`, the smaller spectral value of `(x∘x + y∘y)^(1/2)`, without its cancellation.

    `head² - tail²`, the product of the spectral values of `x∘x + y∘y`, is a sum of squares.
    """
    if head - tail > 1e-6 * head:
        return math.sqrt(head - tail)
    s = 1.0 / math.sqrt(head + tail)
    a = s * (x[0] * x[0] - x[1] * x[1] - x[2] * x[2])
    b = s * (y[0] * y[0] - y[1] * y[1] - y[2] * y[2])
    c = s * (x[0] * y[0] - x[1] * y[1] - x[2] * y[2])
    d1, d2 = s * (x[0] * y[1] - y[0] * x[1]), s * (x[0] * y[2] - y[0] * x[2])
    e = s * (x[1] * y[2] - x[2] * y[1])
    return math.sqrt(a * a + b * b + 2.0 * (c * c + d1 * d1 + d2 * d2 + e * e))


@jit
def fischer_burmeister(x: Vector, y: Vector) -> Vector:
    """`x + y - (x∘x + y∘y)^(1/2)` in the Jordan algebra of the Lorentz cone [Daviet 2011]."""
    head = x[0] * x[0] + x[1] * x[1] + x[2] * x[2] + y[0] * y[0] + y[1] * y[1] + y[2] * y[2]
    v1 = 2.0 * (x[0] * x[1] + y[0] * y[1])
    v2 = 2.0 * (x[0] * x[2] + y[0] * y[2])
    tail = math.sqrt(v1 * v1 + v2 * v2)
    if head == 0.0:
        return (0.0, 0.0, 0.0)
    low, high = smaller_root(x, y, head, tail), math.sqrt(head + tail)
    scale = 0.5 * (high - low) / tail if tail > 0.0 else 0.0
    return (x[0] + y[0] - 0.5 * (low + high), x[1] + y[1] - scale * v1, x[2] + y[2] - scale * v2)
