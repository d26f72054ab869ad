"""Accelerated projected gradient, with the slip term of Coulomb's law frozen or followed.

Nesterov's method with the step length from backtracking and the momentum dropped whenever it goes uphill. From the
extrapolated point z, `x⁺ = P_K(z − g / L)`, `g = A z + c + s e`, with L doubled until `dᵀA d ≤ L ‖d‖²`, `d = x⁺ − z`.
One product with the matrix an iteration, another for each doubling.

With a frozen slip term s it minimises `½ xᵀA x + (c + s e)ᵀx` over the cones. With the slip term followed, s is
that of z at each iteration; there is no function then that must fall, and only the test on `g` drops the momentum.

References: Nesterov, Soviet Math. Dokl. 27, 1983; O'Donoghue and Candès, Found. Comput. Math. 15, 2015; Mazhar, Heyn,
Negrut and Tasora, ACM TOG 34(3), 2015, who solve the convexified law (s = 0) by it.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fibercontact.gauss_seidel.blocks import velocity
from fibercontact.global_methods.scaled import Scaled, cone_residual, with_slip
from fibercontact.jit import jit
from fibercontact.problem.cone import project_cone

__all__ = ["Accelerated", "accelerated", "begin_accelerated"]

Array = NDArray[np.float64]

EASE = 0.9
"""Factor of L from one iteration to the next, so that it can shrink."""
SMALLEST = 1e-12
"""L, whose largest useful value is near 3 times the contacts that a rod has, is never below this."""


class Accelerated(NamedTuple):
    """Iterate and memory of the method."""

    x: Array  # (3n,) impulses
    y: Array  # (3n,) A x + c
    best: Array  # (3n,) the impulses with the least residual
    z: Array  # (3n,) extrapolated impulses
    y_z: Array  # (3n,) A z + c
    trial: Array  # (3n,) next impulses
    y_trial: Array  # (3n,)
    state: Array  # (3,): least residual, L, theta of the momentum


def begin_accelerated(p: Scaled, x: Array) -> Accelerated:
    """Start at the impulses `x`, which lie in the cones."""
    y = np.empty_like(x)
    velocity(p.A, x, y)
    trial, y_trial = np.empty((2, len(x)))
    return Accelerated(
        x.copy(), y, x.copy(), x.copy(), y.copy(), trial, y_trial, np.array([math.inf, 1.0, 1.0])
    )


@jit
def accelerated(p: Scaled, slip: Array, m: Accelerated, target: float, budget: int) -> tuple[int, bool]:
    """Iterate until the residual is at most `target`; returns the iterations done, at most `budget`, and whether."""
    for k in range(budget):
        if look(p, slip, m, target):
            return k, True
        step(p, slip, m)
    return budget, look(p, slip, m, target)


@jit
def look(p: Scaled, slip: Array, m: Accelerated, target: float) -> bool:
    """Measure the iterate and keep it if it is the best; NaN ends the iterations, too."""
    residual = cone_residual(p, slip, m.x, m.y)
    if residual < m.state[0]:
        m.state[0] = residual
        m.best[:] = m.x
    return not residual > target


@jit
def step(p: Scaled, slip: Array, m: Accelerated) -> None:
    """One iteration."""
    uphill = gradient_step(p, slip, m) > 0.0
    theta = 1.0 if uphill else m.state[2]
    root = 0.5 * theta * (math.sqrt(theta * theta + 4.0) - theta)
    beta = 0.0 if uphill else theta * (1.0 - theta) / (theta * theta + root)
    for c in range(len(m.x)):
        m.z[c] = m.trial[c] + beta * (m.trial[c] - m.x[c])
        m.y_z[c] = m.y_trial[c] + beta * (m.y_trial[c] - m.y[c])
        m.x[c], m.y[c] = m.trial[c], m.y_trial[c]
    m.state[1] = max(SMALLEST, EASE * m.state[1])
    m.state[2] = 1.0 if uphill else root


@jit
def gradient_step(p: Scaled, slip: Array, m: Accelerated) -> float:
    """Write `P_K(z − g/L)` and its velocity into the trial, L large enough; returns `gᵀ(trial − x)`."""
    while True:
        along = project_step(p, slip, m)
        velocity(p.A, m.trial, m.y_trial)
        dd = curvature = 0.0
        for c in range(len(m.x)):
            d = m.trial[c] - m.z[c]
            dd += d * d
            curvature += d * (m.y_trial[c] - m.y_z[c])
        if not curvature > m.state[1] * dd:
            return along
        m.state[1] = max(2.0 * m.state[1], curvature / dd)


@jit
def project_step(p: Scaled, slip: Array, m: Accelerated) -> float:
    """Write `P_K(z − g/L)` into the trial; returns `gᵀ(trial − x)`."""
    along, a = 0.0, 1.0 / m.state[1]
    for i in range(len(p.root)):
        g = with_slip(p.A.mu, slip, m.y_z, i)
        z = (m.z[3 * i], m.z[3 * i + 1], m.z[3 * i + 2])
        k = project_cone((z[0] - a * g[0], z[1] - a * g[1], z[2] - a * g[2]), p.A.mu[i])
        for c in range(3):
            m.trial[3 * i + c] = k[c]
            along += g[c] * (k[c] - m.x[3 * i + c])
    return along
