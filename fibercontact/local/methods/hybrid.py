"""Hybrid of MFB and enumeration: simple cases enumerated, Newton first, enumeration as the fail-safe.

Order: (1) take-off and stick by enumeration; (2) slip by damped Newton on the modified Fischer–Burmeister
function from the last impulse; (3) when Newton fails, or claims what the residual of the law denies, its impulse is
corrected as a slip; (4) when that fails, the closed formula for the slip quartic gives a rough impulse that Newton
and the corrections refine; (5) when that fails too, the companion matrix does; the answer with the least residual
is kept.

Reference: Daviet, Bertails-Descoubes and Boissieux, ACM TOG 30(6), 2011; the 2014 talk's "MFB + Enum".
Fails only when all three answers miss the accepted residual; met only for answers of more than 1e10 times b.
"""

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
)
from fibercontact.local.contract import LocalSolver, Matrix, Status
from fibercontact.local.fischer_burmeister import mfb
from fibercontact.local.newton import NEWTON_OPTIONS
from fibercontact.local.slip_quartic import ENUMERATIVE_OPTIONS, closed_slip, companion_slip
from fibercontact.local.slip_refinement import refine_slip
from fibercontact.problem.cone import Vector

__all__ = ["solver"]


@jit
def refine(
    W: Matrix, b: Vector, mu: float, t: Tangential, r: Vector, options: NDArray[np.float64]
) -> tuple[float, Vector, int]:
    """The better of a rough slip and Newton's answer from there, corrected as a slip, with its residual."""
    _, newton_r, iterations = mfb(W, b, mu, r, options)
    better = newton_r if law_residual(W, b, mu, newton_r) < law_residual(W, b, mu, r) else r
    residual, r = refine_slip(W, b, mu, t, better)
    return residual, r, iterations


@jit
def enumerate_slip(
    W: Matrix, b: Vector, mu: float, t: Tangential, r: Vector, options: NDArray[np.float64]
) -> tuple[int, Vector, int]:
    """Fail-safe: `r` corrected, then rough slips by the two enumerations, refined; the best of them."""
    total = 0
    least, r = refine_slip(W, b, mu, t, r)
    for enumeration in range(2):
        if meets(W, b, mu, r, least, options[2]):
            break
        if enumeration == 0:
            status, rough = closed_slip(W, b, mu, t, options[2])
        else:
            status, rough = companion_slip(W, b, mu, t, options[2])
        if status != Status.NO_ROOT:
            residual, candidate, iterations = refine(W, b, mu, t, rough, options)
            total += iterations
            if not residual >= least:
                least, r = residual, candidate
    return Status.CONVERGED if meets(W, b, mu, r, least, options[2]) else Status.INACCURATE, r, total


@jit
def kernel(
    W: Matrix, b: Vector, mu: float, r: Vector, options: NDArray[np.float64]
) -> tuple[int, Vector, int]:
    """Solve one contact; see the module's docstring."""
    if not is_finite(W, b, mu):
        return Status.NOT_FINITE, r, 0
    t = eliminate_normal(W, b)
    regime, simple = open_or_stick(t, b, mu)
    if regime != SLIP:
        return Status.CONVERGED, simple, 0
    status, slip, iterations = mfb(W, b, mu, r, options)
    if status == Status.CONVERGED:
        return status, slip, iterations
    status, slip, more = enumerate_slip(W, b, mu, t, slip, options)
    return status, slip, iterations + more


@jit
def first(
    W: Matrix, b: Vector, mu: float, r: Vector, options: NDArray[np.float64]
) -> tuple[int, Vector, int]:
    """Steps (1) and (2) of the kernel alone: where they fail, it goes on to (3)."""
    if not is_finite(W, b, mu):
        return Status.NOT_FINITE, r, 0
    regime, simple = open_or_stick(eliminate_normal(W, b), b, mu)
    if regime != SLIP:
        return Status.CONVERGED, simple, 0
    return mfb(W, b, mu, r, options)


solver = LocalSolver(
    kernel, options=NEWTON_OPTIONS | {"accepted": ENUMERATIVE_OPTIONS["tolerance"]}, first=first
)
