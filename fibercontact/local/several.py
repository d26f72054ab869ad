"""Ask a local solver for several contacts at once, outside of a sweep."""

from typing import Any

import numpy as np
from numba import types
from numba.core import config
from numpy.typing import NDArray

from fibercontact.jit import jit
from fibercontact.lanes import LANES, load, store
from fibercontact.local.contract import SEVERAL_SIGNATURE, Matrix
from fibercontact.local.registry import Configured
from fibercontact.problem.cone import Vector

__all__ = ["one_by_one", "solve_several"]

Array = NDArray[np.float64]


@jit
def one_by_one(W: Matrix, b: Vector, mu: float, r: Vector, options: Array) -> tuple[float, Vector, float]:
    """What stands in the place of `several` where a solver has none: nothing is done."""
    zero = 0.0 * mu
    return zero, r, zero


@jit
def _ask(several: Any, given: Array, options: Array, found: Array) -> None:
    """Rows of `given` (16, LANES): `W` by rows, b, mu, r; of `found` (5, LANES): done, r, iterations."""
    x, y = np.ravel(given), np.ravel(found)
    W = (
        (load(x, 0), load(x, LANES), load(x, 2 * LANES)),
        (load(x, 3 * LANES), load(x, 4 * LANES), load(x, 5 * LANES)),
        (load(x, 6 * LANES), load(x, 7 * LANES), load(x, 8 * LANES)),
    )
    b = (load(x, 9 * LANES), load(x, 10 * LANES), load(x, 11 * LANES))
    r = (load(x, 13 * LANES), load(x, 14 * LANES), load(x, 15 * LANES))
    done, r, iterations = several(W, b, load(x, 12 * LANES), r, options)
    store(y, 0, done)
    for k in range(3):
        store(y, (1 + k) * LANES, r[k])
    store(y, 4 * LANES, iterations)


_LAID_OUT = types.float64[:, ::1]


def _compile() -> None:
    """Compile `_ask` for every solver at once: one that knew its solver would be kept on disk with it, each anew."""
    if config.DISABLE_JIT or _ask.signatures:
        return
    _ask.compile(types.void(types.FunctionType(SEVERAL_SIGNATURE), _LAID_OUT, types.float64[::1], _LAID_OUT))
    _ask.disable_compile()


def solve_several(
    local: Configured, W: Array, b: Array, mu: Array, r: Array
) -> tuple[NDArray[np.bool_], Array, NDArray[np.int64]]:
    """Of contacts `W` (m, 3, 3), `b` (m, 3), `mu` (m,), `r` (m, 3) which are done, the impulses, the iterations.

    Raises `ValueError` when the solver takes one contact at a time.
    """
    several = local.several()
    if several is None:
        raise ValueError(f"{local.label} solves one contact at a time")
    contacts = np.column_stack([np.reshape(W, (-1, 9)), b, mu, r])
    groups = -(-len(contacts) // LANES)
    _compile()
    padded = contacts[np.arange(groups * LANES) % len(contacts)].reshape(groups, LANES, 16)
    found = np.empty((groups, 5, LANES))
    for k in range(groups):
        _ask(several, np.ascontiguousarray(padded[k].T), local.options, found[k])
    rows = found.transpose(0, 2, 1).reshape(-1, 5)[: len(contacts)]
    return rows[:, 0] == 1.0, rows[:, 1:4], rows[:, 4].astype(np.int64)
