"""Spectral projected gradient, with the slip term of Coulomb's law frozen or followed.

With a frozen slip term s it minimises `q(x) = ½ xᵀA x + (c + s e)ᵀx` over the cones. A step goes along
`d = P_K(x − a g) − x`, `g = A x + c + s e`, as far as q stays below the largest of its last values (nonmonotone line
search), and else to the minimum of q on the way. The step length is one of Barzilai and Borwein's, the shorter one
when the two differ by much. `A d`, one product with the matrix, is all that an iteration costs.

With the slip term followed, `s_i = mu_i ‖y_T,i‖` at each iterate and there is no q. What is compared then is the
sum of the changes of q so far, each with the slip term of its own iteration: the step is safeguarded by every q in
turn, which keeps it finite and proves nothing.

References: Barzilai and Borwein, IMA J. Numer. Anal. 8, 1988; Birgin, Martínez and Raydan, SIAM J. Optim. 10, 2000;
Zhou, Gao and Dai, Comput. Optim. Appl. 35, 2006, for the choice of the step length.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fibercontact.gauss_seidel.blocks import velocity
from fibercontact.global_methods.scaled import Scaled, cone_residual, with_slip
from fibercontact.jit import jit
from fibercontact.problem.cone import project_cone

__all__ = ["Spectral", "begin_spectral", "spectral"]

Array = NDArray[np.float64]

WINDOW = 10
"""Values of q that the next one is compared with."""
ALTERNATE = 0.5
"""Ratio of the two step lengths below which the shorter one is taken."""
SUFFICIENT = 1e-4
LONGEST = 1e10
FRESH = 50
"""Iterations after which the velocity is computed afresh, against the drift of its updates."""


class Spectral(NamedTuple):
    """Iterate and memory of the method."""

    x: Array  # (3n,) impulses
    y: Array  # (3n,) A x + c
    best: Array  # (3n,) the impulses with the least residual
    d: Array  # (3n,) direction
    Ad: Array  # (3n,)
    q: Array  # (WINDOW,) last values, that of iteration k at k % WINDOW
    state: Array  # (3,): least residual, iterations done, step length


def begin_spectral(p: Scaled, x: Array) -> Spectral:
    """Start at the impulses `x`, which lie in the cones."""
    y, d, Ad = np.empty((3, len(x)))
    velocity(p.A, x, y)
    q = np.full(WINDOW, -math.inf)
    q[0] = 0.0
    return Spectral(x.copy(), y, x.copy(), d, Ad, q, np.array([math.inf, 0.0, 1.0]))


@jit
def spectral(p: Scaled, slip: Array, m: Spectral, target: float, budget: int) -> tuple[int, bool]:
    """Iterate until the residual is at most `target`; returns the iterations done, at most `budget`, and whether."""
    for k in range(budget):
        if look(p, slip, m, target):
            return k, True
        step(p, slip, m)
    return budget, look(p, slip, m, target)


@jit
def look(p: Scaled, slip: Array, m: Spectral, target: float) -> bool:
    """Measure the iterate and keep it if it is the best; a residual that meets the target is confirmed.

    NaN ends the iterations, too.
    """
    residual = cone_residual(p, slip, m.x, m.y)
    if residual <= target:
        velocity(p.A, m.x, m.y)
        residual = cone_residual(p, slip, m.x, m.y)
    if residual < m.state[0]:
        m.state[0] = residual
        m.best[:] = m.x
    return not residual > target


@jit
def step(p: Scaled, slip: Array, m: Spectral) -> None:
    """One iteration."""
    slope = direction(p, slip, m)
    velocity(p.linear, m.d, m.Ad)
    dd, curvature, AdAd = np.dot(m.d, m.d), np.dot(m.d, m.Ad), np.dot(m.Ad, m.Ad)
    k = int(m.state[1])
    q = m.q[k % WINDOW]
    full = q + slope + 0.5 * curvature <= m.q.max() + SUFFICIENT * slope
    t = 1.0 if full or not curvature > 0.0 else min(1.0, -slope / curvature)
    m.q[(k + 1) % WINDOW] = q + t * slope + 0.5 * t * t * curvature
    for c in range(len(m.x)):
        m.x[c] += t * m.d[c]
        m.y[c] += t * m.Ad[c]
    m.state[1] += 1.0
    if (k + 1) % FRESH == 0:
        velocity(p.A, m.x, m.y)
    m.state[2] = step_length(dd, curvature, AdAd)


@jit
def direction(p: Scaled, slip: Array, m: Spectral) -> float:
    """Write `P_K(x − a g) − x` into d; returns `gᵀd`."""
    slope, a = 0.0, m.state[2]
    for i in range(len(p.root)):
        g = with_slip(p.A.mu, slip, m.y, i)
        x = (m.x[3 * i], m.x[3 * i + 1], m.x[3 * i + 2])
        k = project_cone((x[0] - a * g[0], x[1] - a * g[1], x[2] - a * g[2]), p.A.mu[i])
        for c in range(3):
            m.d[3 * i + c] = k[c] - x[c]
            slope += g[c] * (k[c] - x[c])
    return slope


@jit
def step_length(dd: float, curvature: float, AdAd: float) -> float:
    """The longer of Barzilai and Borwein's step lengths, the shorter one where it is shorter by much."""
    if not (curvature > 0.0 and AdAd > 0.0):
        return LONGEST if dd > 0.0 else 1.0
    long, short = dd / curvature, curvature / AdAd
    return min(LONGEST, short if short < ALTERNATE * long else long)
