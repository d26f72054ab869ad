"""Several numbers in one: `LANES` contacts are solved by the arithmetic that solves one.

`Lanes` holds a number for each of several contacts, `Mask` an answer to a question about each. In compiled code
operators, `math.sqrt`, `abs`, `max` and the functions of this module work on them as on one number and one truth
value, with the same rounding; on a processor with vector registers that takes hardly longer than for one contact.
Plain numbers may stand beside them. `and`, `or` and `not` are `&`, `|` and `~`, and `if` is `where`.
"""

import math
import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin, lower_cast, models, register_model

__all__ = ["LANES", "Lanes", "Mask", "every", "load", "ratio", "store", "where"]

LANES = 8

_INDEX = ir.IntType(32)
_NUMBERS = ir.VectorType(ir.DoubleType(), LANES)
_ANSWERS = ir.VectorType(ir.IntType(1), LANES)


class _LanesType(types.Type):
    def __init__(self) -> None:
        super().__init__("Lanes")


class _MaskType(types.Type):
    def __init__(self) -> None:
        super().__init__("Mask")


Lanes, Mask = _LanesType(), _MaskType()
"""Numba's types of several numbers, and of several truth values."""


@register_model(_LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _NUMBERS)


@register_model(_MaskType)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _ANSWERS)


@lower_cast(types.Float, _LanesType)
@lower_cast(types.Integer, _LanesType)
def _everywhere(context: Any, builder: Any, kind: Any, _: Any, x: Any) -> Any:
    number = context.cast(builder, x, kind, types.float64)
    undefined = ir.Constant(_NUMBERS, ir.Undefined)
    one = builder.insert_element(undefined, number, ir.Constant(_INDEX, 0))
    return builder.shuffle_vector(one, undefined, ir.Constant(ir.VectorType(_INDEX, LANES), [0] * LANES))


def ratio(x: float, y: float, otherwise: float) -> float:
    """`x / y`, or what is given otherwise where y is zero."""
    return x / y if y != 0.0 else otherwise


def where(answer: bool, x: float, y: float) -> float:
    """`x` where the answer is yes, else `y`; both have been computed."""
    return x if answer else y


def every(answer: bool) -> bool:
    """Whether the answer is yes in all lanes."""
    return answer


def _is_number(kind: Any) -> bool:
    return kind is Lanes or isinstance(kind, types.Float | types.Integer)


def _fits(found: Any, kind: Any) -> bool:
    return _is_number(found) if kind is Lanes else found is kind


def _define(function: Any, given: tuple[Any, ...], result: Any, generate: Callable[..., Any]) -> None:
    """Give a function a meaning in compiled code for such arguments; plain numbers beside lanes become lanes.

    Without lanes or masks among the arguments it is what a function of this module means for one number.
    """
    for_one = Lanes not in given and Mask not in given

    class Template(AbstractTemplate):
        def generic(self, found: Any, _: Any) -> Any:
            some = Lanes in found or Mask in found
            fit = len(found) == len(given) and (
                not some if for_one else some and all(map(_fits, found, given))
            )
            return signature(result, *given) if fit else None

    infer_global(function)(Template)
    lower_builtin(function, *given)(lambda context, builder, _, found: generate(builder, *found))


def _vector_function(name: str) -> Callable[..., Any]:
    def generate(builder: Any, *given: Any) -> Any:
        kind = ir.FunctionType(_NUMBERS, [_NUMBERS] * len(given))
        return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), given)

    return generate


def _compared(sign: str) -> Callable[..., Any]:
    # As for one number: NaN equals nothing and differs from everything.
    return lambda builder, x, y: (builder.fcmp_unordered if sign == "!=" else builder.fcmp_ordered)(
        sign, x, y
    )


def _larger(builder: Any, x: Any, y: Any) -> Any:
    """As Python's `max(x, y)`."""
    return builder.select(builder.fcmp_ordered(">", y, x), y, x)


def _ratio(builder: Any, x: Any, y: Any, otherwise: Any) -> Any:
    zero = ir.Constant(y.type, [0.0] * LANES if y.type == _NUMBERS else 0.0)
    return builder.select(builder.fcmp_unordered("!=", y, zero), builder.fdiv(x, y), otherwise)


def _every(builder: Any, answer: Any) -> Any:
    bits = ir.IntType(LANES)
    return builder.icmp_unsigned("==", builder.bitcast(answer, bits), ir.Constant(bits, 2**LANES - 1))


_TWO = (Lanes, Lanes)
for _function, _name in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _define(_function, _TWO, Lanes, lambda builder, x, y, name=_name: getattr(builder, name)(x, y))
for _function, _sign in (
    (operator.lt, "<"),
    (operator.le, "<="),
    (operator.gt, ">"),
    (operator.ge, ">="),
    (operator.ne, "!="),
):
    _define(_function, _TWO, Mask, _compared(_sign))
_define(operator.and_, (Mask, Mask), Mask, lambda builder, x, y: builder.and_(x, y))
_define(operator.or_, (Mask, Mask), Mask, lambda builder, x, y: builder.or_(x, y))
_define(operator.invert, (Mask,), Mask, lambda builder, x: builder.not_(x))
_define(operator.neg, (Lanes,), Lanes, lambda builder, x: builder.fneg(x))
_define(math.sqrt, (Lanes,), Lanes, _vector_function(f"llvm.sqrt.v{LANES}f64"))
_define(abs, (Lanes,), Lanes, _vector_function(f"llvm.fabs.v{LANES}f64"))
_define(max, _TWO, Lanes, _larger)
_define(where, (Mask, Lanes, Lanes), Lanes, lambda builder, *given: builder.select(*given))
_define(ratio, (Lanes, Lanes, Lanes), Lanes, _ratio)
_define(every, (Mask,), types.boolean, _every)
_ONE = types.float64
_define(where, (types.boolean, _ONE, _ONE), _ONE, lambda builder, *given: builder.select(*given))
_define(ratio, (_ONE, _ONE, _ONE), _ONE, _ratio)


def _place(context: Any, builder: Any, kind: Any, array: Any, index: Any) -> Any:
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), _NUMBERS.as_pointer())


@intrinsic
def load(context: Any, array: Any, index: Any) -> Any:
    """The lanes whose numbers are `array[index : index + LANES]`; in compiled code alone."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        return builder.load(_place(context, builder, signature.args[0], *given), align=8)

    return Lanes(array, types.int64), generate


@intrinsic
def store(context: Any, array: Any, index: Any, x: Any) -> Any:
    """Write lanes to `array[index : index + LANES]`; in compiled code alone."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        array, index, x = given
        builder.store(x, _place(context, builder, signature.args[0], array, index), align=8)
        return context.get_dummy_value()

    return types.void(array, types.int64, Lanes), generate
