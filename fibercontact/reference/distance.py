"""How far two answers are from each other, in velocities: impulses are not unique and never compared."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fibercontact.problem.measure import relative
from fibercontact.problem.step import StepProblem
from fibercontact.reference.conic import Problem

__all__ = ["friction_work", "velocity_error"]

Array = NDArray[np.float64]


def velocity_error(problem: Problem, r: Array, r_ref: Array) -> float:
    """Distance of the velocities of the impulses `r` (3n,) from those of `r_ref`, in the norm of kinetic energy.

    `‖v − v_ref‖_M = ‖r − r_ref‖_W` needs no `M`. Relative to `‖v_ref‖_M`, or, where `M` is not known, to `‖r_ref‖_W`,
    the velocity that the contacts give; absolute, in the square root of a joule, when that is zero.
    """
    if isinstance(problem, StepProblem):
        v, v_ref = problem.velocities(r), problem.velocities(r_ref)
        return relative(_norm(problem.M, v - v_ref), _norm(problem.M, v_ref))
    return relative(_norm(problem.W, r - r_ref), _norm(problem.W, r_ref))


def _norm(A: Any, x: Array) -> float:
    """`‖x‖_A`; rounding may make the square of a zero negative."""
    return math.sqrt(max(float(x @ (A @ x)), 0.0))


def friction_work(u: Array, r: Array) -> float:
    """Energy in J that friction dissipates, `Σ max(−u_T·r_T, 0)`: what it creates is measured apart."""
    power = -np.einsum("ij,ij->i", u.reshape(-1, 3)[:, 1:], r.reshape(-1, 3)[:, 1:])
    return float(np.maximum(power, 0.0).sum())
