"""Take-off and stick tested first, then slip by bisection on alpha.

In slip `u_N = 0` and `u_T = -alpha r_T` for some `alpha > 0`. That makes `r` a function of alpha alone, and
`phi(alpha) = |r_T| - mu r_N` is positive near 0, where stick was excluded, and negative at `largest_alpha`: the root
between them is closed in on by halves. Reference: THEORY §3. Slow and steady; misses where `W` is so weak along the
impulse that rounding hides b.
"""

# The first line above is what `fibercontact solvers` and the reports say of this solver: keep it one sentence.
# Change what follows, save, and run `fibercontact check` on this file: an edit takes effect at once.

import math

import numpy as np
from numpy.typing import NDArray

from fibercontact.jit import jit
from fibercontact.local.algebra import (
    SLIP,
    Tangential,
    eliminate_normal,
    is_finite,
    law_residual,
    meets,
    open_or_stick,
    slip_impulse,
)
from fibercontact.local.contract import LocalSolver, Matrix, Option, Status
from fibercontact.problem.cone import Vector

__all__ = ["solver"]


# Kernels and what they call are compiled by @jit: scalars, tuples and loops, no lists or dictionaries. To step
# through them in a debugger set NUMBA_DISABLE_JIT=1.
@jit
def largest_alpha(t: Tangential, mu: float) -> float:
    """An alpha at which `phi` is negative, from bounds on `|r_T|` and `r_N`."""
    load, coupling = math.hypot(t.c1, t.c2), math.hypot(t.w1, t.w2)
    return 2.0 * load * (t.W_NN / mu + coupling) / -t.b_N


@jit
def kernel(
    W: Matrix, b: Vector, mu: float, r: Vector, options: NDArray[np.float64]
) -> tuple[int, Vector, int]:
    """Solve one contact: find `r` such that `u = W r + b` and `r` obey Coulomb's law.

    `W` is three rows, `b` and `r` are `(N, T1, T2)`; `r` comes in as the impulse of the last visit (it is not needed
    here) and goes out as the answer, with a status and the number of iterations.
    """
    if not is_finite(W, b, mu):  # a status, never an exception; and never a loop without an end
        return Status.NOT_FINITE, r, 0
    t = eliminate_normal(W, b)
    regime, r = open_or_stick(t, b, mu)
    if regime != SLIP:
        return Status.CONVERGED, r, 0
    tolerance, budget = options[0], int(options[1])  # in the order of their declaration below
    low, high = 0.0, largest_alpha(t, mu)
    for k in range(budget):
        alpha = 0.5 * (low + high)
        r = slip_impulse(t, alpha)
        phi = math.hypot(r[1], r[2]) - mu * r[0]
        if abs(phi) <= tolerance * mu * r[0] or not low < alpha < high:
            # CONVERGED is a claim, which the harness verifies: look at the residual before making it.
            honest = meets(W, b, mu, r, law_residual(W, b, mu, r), 1e-6)
            return Status.CONVERGED if honest else Status.INACCURATE, r, k + 1
        if phi > 0.0:
            low = alpha
        else:
            high = alpha
    return Status.ITERATIONS, r, budget


# The options can be set where the solver is named: `NAME:tolerance=1e-6,max_iterations=50`.
solver = LocalSolver(
    kernel,
    options={
        "tolerance": Option(1e-12, "relative width of | |r_T| - mu r_N | at which to stop"),
        "max_iterations": Option(200, "halvings of the bracket"),
    },
)
