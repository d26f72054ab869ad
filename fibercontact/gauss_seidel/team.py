"""Threads that go through the same sweeps together, each doing its part.

Every thread runs the whole loop and takes the same decisions from the same numbers; `wait` keeps them in step. What
is added up is added in an order that does not depend on the number of threads, so the answer does not either.

The threads wait actively: a sweep of some thousand contacts takes 100 µs, less than to wake a sleeping thread.
"""

import os
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils, config
from numba.extending import intrinsic
from numpy.typing import NDArray

from fibercontact.jit import jit

__all__ = ["Team", "alone", "gather", "share", "wait"]

_APART = 8  # numbers of a cache line
_SPINS = 2000
"""Looks at the gate before the core is offered to others."""


class Team(NamedTuple):
    """A thread among `size` that share a `gate`, and the thread that takes each part of a sweep."""

    rank: int
    size: int
    gate: NDArray[np.int64]  # (16,): arrivals, and the number of times that it has opened
    owner: NDArray[np.int32]  # (parts,)


def gather(size: int, owner: NDArray[np.int32]) -> list[Team]:
    """The members of a team."""
    gate = np.zeros(2 * _APART, dtype=np.int64)
    return [Team(rank, size, gate, owner) for rank in range(size)]


@jit
def alone(parts: int) -> Team:
    """A team of one, that takes all parts."""
    return Team(0, 1, np.zeros(0, dtype=np.int64), np.zeros(parts, dtype=np.int32))


@jit
def share(count: int, team: Team) -> tuple[int, int]:
    """The thread's part of `0..count`."""
    return count * team.rank // team.size, count * (team.rank + 1) // team.size


@intrinsic
def _atomic_add(context: Any, array: Any, index: Any, value: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array, index, value = arguments
        data = context.make_array(signature.args[0])(context, builder, array).data
        return builder.atomic_rmw("add", builder.gep(data, [index]), value, "seq_cst")

    return types.int64(array, types.int64, types.int64), generate


@intrinsic
def _atomic_load(context: Any, array: Any, index: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array, index = arguments
        data = context.make_array(signature.args[0])(context, builder, array).data
        return builder.load_atomic(builder.gep(data, [index]), "seq_cst", 8)

    return types.int64(array, types.int64), generate


@intrinsic
def _offer_core(context: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        if hasattr(os, "sched_yield"):
            kind = ir.FunctionType(ir.IntType(32), [])
            builder.call(cgutils.get_or_insert_function(builder.module, kind, "sched_yield"), [])
        return context.get_dummy_value()

    return types.void(), generate


@jit
def _wait(team: Team) -> None:
    gate = team.gate
    opened = _atomic_load(gate, _APART)
    if _atomic_add(gate, 0, 1) == team.size - 1:
        _atomic_add(gate, 0, -team.size)
        _atomic_add(gate, _APART, 1)
        return
    looks = 0
    while _atomic_load(gate, _APART) == opened:
        looks += 1
        if looks > _SPINS:
            _offer_core()


def _no_wait(team: Team) -> None:
    """Interpreted teams are of one."""


_together: Any = _no_wait if config.DISABLE_JIT else _wait


@jit
def wait(team: Team) -> None:
    """Go on when all of the team have come here, with all that they have written."""
    if team.size > 1:
        _together(team)
