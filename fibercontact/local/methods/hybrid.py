"""Hybrid of MFB and enumeration: simple cases enumerated, Newton first, enumeration as the fail-safe.

Order: (1) take-off and stick by enumeration; (2) slip by damped Newton on the modified Fischer–Burmeister
function from the last impulse; (3) when Newton fails, the closed formula for the slip quartic gives a rough
impulse that Newton refines; (4) when that fails too, the companion matrix does; the answer with the least
residual is kept.

Reference: Daviet, Bertails-Descoubes and Boissieux, ACM TOG 30(6), 2011; the 2014 talk's "MFB + Enum".
Fails only when all three answers miss the accepted residual, at condition numbers of `W` beyond about 1e10.
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
    open_or_stick,
)
from fibercontact.local.contract import LocalSolver, Matrix, Status
from fibercontact.local.fischer_burmeister import modified_fischer_burmeister
from fibercontact.local.newton import NEWTON_OPTIONS, newton
from fibercontact.local.slip_quartic import ENUMERATIVE_OPTIONS, closed_slip, companion_slip
from fibercontact.problem.cone import Vector, norm

__all__ = ["solver"]


@jit
def mfb(W: Matrix, b: Vector, mu: float, r: Vector, options: NDArray[np.float64]) -> tuple[int, Vector, int]:
    """Damped Newton on the modified Fischer–Burmeister function."""
    return newton(modified_fischer_burmeister, W, b, mu, r, options[0], int(options[1]), True, 1.0, 0.0)


@jit
def refine(
    W: Matrix, b: Vector, mu: float, r: Vector, options: NDArray[np.float64]
) -> tuple[float, Vector, int]:
    """The better of a rough impulse and Newton's answer from there, with its residual."""
    rough = law_residual(W, b, mu, r)
    _, newton_r, iterations = mfb(W, b, mu, r, options)
    refined = law_residual(W, b, mu, newton_r)
    return (refined, newton_r, iterations) if refined < rough else (rough, r, iterations)


@jit
def enumerate_slip(
    W: Matrix, b: Vector, mu: float, t: Tangential, r: Vector, options: NDArray[np.float64]
) -> tuple[int, Vector, int]:
    """Fail-safe: rough slips by the two enumerations, refined; the best of them and `r`."""
    accepted = options[2] * norm(b)
    least = law_residual(W, b, mu, r)
    total = 0
    for enumeration in range(2):
        if enumeration == 0:
            status, rough = closed_slip(W, b, mu, t, options[2])
        else:
            status, rough = companion_slip(W, b, mu, t, options[2])
        if status != Status.NO_ROOT:
            residual, candidate, iterations = refine(W, b, mu, rough, options)
            total += iterations
            if not residual >= least:
                least, r = residual, candidate
        if least <= accepted:
            return Status.CONVERGED, r, total
    return Status.INACCURATE, r, total


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
