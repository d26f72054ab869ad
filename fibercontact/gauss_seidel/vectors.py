"""Arithmetic on whole block rows that the compiler does not find by itself.

Velocities are kept four numbers apart, the fourth of no meaning, so that the product of a 3×3 block and an impulse is
added to them by three vector instructions. The compiler would do it number by number, in twice the time.
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils, config
from numba.extending import intrinsic
from numpy.typing import NDArray

__all__ = ["LINE", "PAD", "STRIDE", "add_block", "fetch"]

STRIDE = 4
"""Numbers from one contact's velocity to the next's."""
LINE = 8
"""Numbers of a cache line."""
PAD = 1
"""Numbers after the last block, which are read and have no influence."""

_VECTOR = ir.VectorType(ir.DoubleType(), STRIDE)
_UNDEFINED = ir.Constant(_VECTOR, ir.Undefined)
_FIRST = ir.Constant(ir.VectorType(ir.IntType(32), STRIDE), [0] * STRIDE)


def _everywhere(builder: Any, x: Any) -> Any:
    """The vector with `x` in every place."""
    one = builder.insert_element(_UNDEFINED, x, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(one, _UNDEFINED, _FIRST)


def _place(context: Any, builder: Any, kind: Any, array: Any, index: Any) -> Any:
    """Where in memory the vector begins that starts with `array[index]`."""
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), _VECTOR.as_pointer())


@intrinsic
def _add_block(context: Any, u: Any, at: Any, blocks: Any, k: Any, d0: Any, d1: Any, d2: Any) -> Any:
    signature = types.void(u, types.int64, blocks, types.int64, *3 * (types.float64,))

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        u, at, blocks, k, *d = arguments
        place = _place(context, builder, signature.args[0], u, at)
        total = builder.load(place, align=8)
        for c in range(3):
            begin = builder.add(k, ir.Constant(ir.IntType(64), 3 * c))
            row = builder.load(_place(context, builder, signature.args[2], blocks, begin), align=8)
            product = builder.fmul(row, _everywhere(builder, d[c]), flags=("contract",))
            total = builder.fadd(total, product, flags=("contract",))
        builder.store(total, place, align=8)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def _fetch(context: Any, array: Any, index: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array, index = arguments
        data = context.make_array(signature.args[0])(context, builder, array).data
        place = builder.bitcast(builder.gep(data, [index]), ir.IntType(8).as_pointer())
        number = ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [place.type, *3 * (number,)])
        prefetch = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        builder.call(prefetch, [place, number(0), number(3), number(1)])  # to read, into all caches, data
        return context.get_dummy_value()

    return types.void(array, types.int64), generate


def _fetch_interpreted(array: NDArray[np.float64], index: int) -> None:
    """Bring the cache line of `array[index]` nearer: it will be read soon."""


def _add_block_interpreted(
    u: NDArray[np.float64], at: int, blocks: NDArray[np.float64], k: int, d0: float, d1: float, d2: float
) -> None:
    """`u_j += W_ij^T d`: `u[at:]` is the velocity, `blocks[k:k+9]` the block, row by row."""
    for a in range(3):
        u[at + a] += blocks[k + a] * d0 + blocks[k + 3 + a] * d1 + blocks[k + 6 + a] * d2


fetch: Any = _fetch_interpreted if config.DISABLE_JIT else _fetch
add_block: Any = _add_block_interpreted if config.DISABLE_JIT else _add_block
