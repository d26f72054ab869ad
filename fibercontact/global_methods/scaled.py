"""A problem in the variable that all global methods work in, and what they have in common there.

With `s_i = sqrt(sigma_i)`, `x_i = s_i r_i` and `y_i = u_i / s_i`, the problem is `y = A x + c` with the same law: all
diagonal blocks of `A` have trace 3, so one step length suits all contacts. The residual of THEORY §2 is the root mean
square of `s_i (x_i − P_K(x_i − ỹ_i))`.
"""

import math
import time
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fibercontact.gauss_seidel.blocks import BlockSystem, residual_from, velocity
from fibercontact.global_methods.contract import Answer, Task, Unsuited
from fibercontact.jit import jit
from fibercontact.problem.cone import COULOMB, Vector, project_cone
from fibercontact.problem.measure import relative

__all__ = [
    "MARGIN", "NO_SLIP", "Budget", "Scaled", "answer", "check_size", "cone_residual", "impulse", "projected", "scale",
    "slip_terms", "start_of", "with_slip",
]  # fmt: skip

Array = NDArray[np.float64]

LARGEST = 10_000
"""Contacts above which the factors of a sparse matrix may not fit into memory."""
SLICE_SECONDS = 0.05
"""The clock is looked at about this often."""
MARGIN = 0.999
"""Share of the tolerance that is met in the scaled variable, so that rounding does not spoil it in the impulses."""
NO_SLIP = np.zeros(0)
"""A slip term that is not frozen: `mu ‖y_T‖` of the velocity at hand."""


class Scaled(NamedTuple):
    """The problem in the variables x and y."""

    A: BlockSystem  # its b is c, its sigma 1: `velocity` is A x + c
    linear: BlockSystem  # the same with c = 0: `velocity` is A x
    root: Array  # (n,) sqrt(sigma_i)


def scale(system: BlockSystem) -> Scaled:
    """Change the variables."""
    root, blocks = np.sqrt(system.sigma), system.blocks.copy()
    row = np.repeat(np.arange(len(root)), np.diff(system.starts))
    blocks[: 9 * len(row)] /= np.repeat(root[row] * root[system.columns], 9)
    b, diagonal = system.b / np.repeat(root, 3), system.diagonal / system.sigma[:, None]
    A = system._replace(blocks=blocks, diagonal=diagonal, sigma=np.ones_like(root), b=b)
    return Scaled(A, A._replace(b=np.zeros_like(b)), root)


def check_size(system: BlockSystem) -> None:
    """Raise `Unsuited` when the factors of a sparse matrix of this size may not fit into memory."""
    if len(system.mu) > LARGEST:
        raise Unsuited(f"factorises a sparse matrix: for at most {LARGEST} contacts, not {len(system.mu)}")


def start_of(p: Scaled, task: Task) -> Array:
    """The starting impulse of the task in the scaled variable, projected on the cones.

    Raises `ValueError` when it has the wrong shape or is not finite.
    """
    x = np.zeros_like(p.A.b)
    if task.start is None:
        return x
    if task.start.shape != x.shape or not np.isfinite(task.start).all():
        raise ValueError(f"the start must be a finite vector of shape {x.shape}, not {task.start.shape}")
    projected(p.A.mu, np.repeat(p.root, 3) * task.start, x)
    return x


@jit
def projected(mu: Array, z: Array, x: Array) -> None:
    """Write the projection of `z` on the cones into `x`."""
    for i in range(len(mu)):
        k = project_cone((z[3 * i], z[3 * i + 1], z[3 * i + 2]), mu[i])
        x[3 * i], x[3 * i + 1], x[3 * i + 2] = k[0], k[1], k[2]


@jit
def with_slip(mu: Array, slip: Array, y: Array, i: int) -> Vector:
    """`y_i + slip_i e` for a frozen slip term, `ỹ_i` where it is not (`NO_SLIP`)."""
    frozen = len(slip) > 0
    term = slip[i] if frozen else mu[i] * math.hypot(y[3 * i + 1], y[3 * i + 2])
    return (y[3 * i] + term, y[3 * i + 1], y[3 * i + 2])


@jit
def cone_residual(p: Scaled, slip: Array, x: Array, y: Array) -> float:
    """Root mean square of `s_i (x_i − P_K(x_i − y_i − slip_i e))`, THEORY §2's residual unless slip is frozen."""
    total, n = 0.0, len(p.root)
    for i in range(n):
        g = with_slip(p.A.mu, slip, y, i)
        z = (x[3 * i], x[3 * i + 1], x[3 * i + 2])
        k = project_cone((z[0] - g[0], z[1] - g[1], z[2] - g[2]), p.A.mu[i])
        e = (z[0] - k[0]) ** 2 + (z[1] - k[1]) ** 2 + (z[2] - k[2]) ** 2
        total += p.root[i] * p.root[i] * e
    return math.sqrt(total / max(1, n))


def slip_terms(p: Scaled, y: Array) -> Array:
    """`mu_i ‖y_T,i‖`, (n,)."""
    return p.A.mu * np.hypot(y[1::3], y[2::3])


def impulse(p: Scaled, x: Array) -> Array:
    """The impulses r (3n,) in N·s."""
    return x / np.repeat(p.root, 3)


def answer(system: BlockSystem, task: Task, r: Array, iterations: int, note: str) -> Answer:
    """The answer with these impulses, measured on a velocity computed afresh."""
    u = np.empty_like(r)
    velocity(system, r, u)
    size = residual_from(system, r, u, COULOMB)
    claimed = size <= task.target
    return Answer(r, claimed, iterations, relative(size, task.b_ref), note="" if claimed else note)


@dataclass
class Budget:
    """The iterations and the seconds that a task leaves."""

    task: Task
    done: int = 0
    began: float = field(default_factory=time.perf_counter)

    @property
    def elapsed(self) -> float:
        """Seconds since the beginning."""
        return time.perf_counter() - self.began

    @property
    def slice(self) -> int:
        """Iterations until the next look at the clock, 0 when iterations or seconds are used up."""
        elapsed = self.elapsed
        if elapsed >= self.task.max_seconds:
            return 0
        pace = int(self.done * SLICE_SECONDS / max(elapsed, 1e-9))
        return min(max(1, pace), self.task.max_iterations - self.done)

    @property
    def note(self) -> str:
        """Why no more is done, where the tolerance is not met."""
        if self.elapsed >= self.task.max_seconds:
            return "the time was exhausted"
        if self.done >= self.task.max_iterations:
            return "the iterations were exhausted"
        return "the residual is not finite"
