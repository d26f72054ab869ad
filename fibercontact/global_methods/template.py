"""Projected gradient with one step length, on all contacts at once.

Equation: `x ← P_K(x − ỹ / L)`, in the variables `x = sqrt(sigma) r`, `y = u / sqrt(sigma)`, `ỹ = y + mu |y_T| e`,
with L the largest eigenvalue of the matrix in them. Reference: THEORY §1, §2. Slow and steady; creeps on stiff
assemblies.
"""

# The first line above is what `fibercontact solvers` and the reports say of this method: keep it one sentence.
# Change what follows, save, and run `fibercontact table` on this file: an edit takes effect at once.

import numpy as np
from numpy.typing import NDArray

from fibercontact.gauss_seidel.blocks import BlockSystem, velocity
from fibercontact.global_methods.contract import Answer, GlobalMethod, Task
from fibercontact.global_methods.scaled import (
    NO_SLIP,
    Budget,
    Scaled,
    answer,
    cone_residual,
    impulse,
    projected,
    scale,
    slip_terms,
    start_of,
)
from fibercontact.local.contract import Option

__all__ = ["solver"]

Array = NDArray[np.float64]


def largest_eigenvalue(p: Scaled, iterations: int) -> float:
    """An estimate of L from below, by power iteration."""
    x = np.ones_like(p.A.b)
    y = np.empty_like(x)
    for _ in range(iterations):
        velocity(p.linear, x / np.linalg.norm(x), y)  # A x; `p.A` gives A x + c
        x, y = y, x
    return float(np.linalg.norm(x))


# A method is plain Python and numpy. What loops over contacts is worth compiling: put @jit (from fibercontact.jit) on
# a function of scalars and arrays; `fibercontact/global_methods` has examples. NUMBA_DISABLE_JIT=1 for a debugger.
def solve(system: BlockSystem, task: Task, options: Array) -> Answer:
    """Solve a problem: find `r` such that `u = W r + b` and `r` obey Coulomb's law at every contact."""
    budget = Budget(task)  # the clock runs: who does not look at it is killed some seconds after its time
    p = scale(system)
    relaxation, powers = options[0], int(options[1])  # in the order of their declaration below
    step = relaxation / max(largest_eigenvalue(p, powers), 1e-300)
    x = start_of(p, task)
    y, best, least = np.empty_like(x), x.copy(), np.inf
    while True:
        velocity(p.A, x, y)
        residual = cone_residual(p, NO_SLIP, x, y)  # that of the harness
        if residual < least:
            best, least = x.copy(), residual
        if residual <= task.target or budget.slice == 0:
            break
        y[::3] += slip_terms(p, y)
        projected(p.A.mu, x - step * y, x)
        budget.done += 1
    # `answer` measures before it claims; what is claimed is verified by the harness, from the impulses alone.
    return answer(system, task, impulse(p, best), budget.done, budget.note)


# The options can be set where the method is named: `NAME:relaxation=1.5`.
solver = GlobalMethod(
    solve,
    options={
        "relaxation": Option(1.0, "step times L; 2 and above diverges"),
        "powers": Option(20, "power iterations for L"),
    },
)
