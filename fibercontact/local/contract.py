"""What a local solver is: the signature of its kernel, its status, its options, and what it owes.

A local solver answers one contact: given `W` (3×3, SPD), `b` (what all the other contacts contribute
included), `mu` and the impulse `r` of the last visit, find the impulse `r` such that `u = W r + b` and `r` obey
its law. The kernel is a pure function of tuples, compiled to one fixed signature, so that the sweep that calls
it is compiled once for all solvers:

    kernel(W, b, mu, r, options) -> (status, r, iterations)

`W` is a tuple of three rows, `b` and `r` are tuples `(N, T1, T2)`, `options` a float64 array in the order of the
declared options; `status` is a `Status`, `iterations` the number of inner (Newton) iterations.

What every kernel owes, and `fibercontact check` looks at: it never raises, loops for ever or writes to `options`;
the same input gives the same bits; data (`W`, `b`, `mu`) that are not finite never end in `CONVERGED`, and
`CONVERGED` never comes with an impulse that is not finite. The rest depends on what it claims to be:

* An *exact* solver (the default) returns `CONVERGED` only when the residual of its law is at most `HONEST`, rounding
  of impulses far larger than b aside. Not to find an answer is no breach where a contact is hard: any other status
  says so, and the sweep damps the impulse that comes with it.
* A *step* (`exact=False`) may stop anywhere: its `CONVERGED` asks the sweep to take the impulse as it is. It must
  leave solutions where they are, and come to the solution of a kind contact when it is visited again and again.
* A solver of a *polygon's law* (`facets`) is either of these, judged by that law instead of Coulomb's.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np
from numba import types
from numpy.typing import NDArray

from fibercontact.lanes import Lanes
from fibercontact.problem.cone import COULOMB, Vector

__all__ = [
    "HONEST", "KERNEL_SIGNATURE", "SENTENCES", "SEVERAL_SIGNATURE", "Declared", "LocalSolver", "Matrix", "Option",
    "Status",
]  # fmt: skip

Matrix = tuple[Vector, Vector, Vector]

HONEST = 1e-6
"""Largest residual, relative to b, of an impulse that an exact solver claims to be the answer."""

_VECTOR = types.UniTuple(types.float64, 3)
KERNEL_SIGNATURE = types.Tuple((types.int64, _VECTOR, types.int64))(
    types.UniTuple(_VECTOR, 3), _VECTOR, types.float64, _VECTOR, types.float64[::1]
)
_VECTORS = types.UniTuple(Lanes, 3)
SEVERAL_SIGNATURE = types.Tuple((Lanes, _VECTORS, Lanes))(
    types.UniTuple(_VECTORS, 3), _VECTORS, Lanes, _VECTORS, types.float64[::1]
)


class Status(IntEnum):
    """How a local solve ended; every value but `CONVERGED` is a failure with its reason."""

    CONVERGED = 0
    ITERATIONS = 1
    STALLED = 2
    SINGULAR = 3
    NO_ROOT = 4
    INACCURATE = 5
    NOT_FINITE = 6


SENTENCES = {
    Status.CONVERGED: "the local tolerance was met",
    Status.ITERATIONS: "the local iterations were exhausted",
    Status.STALLED: "the line search found no decrease",
    Status.SINGULAR: "a linear system was singular",
    Status.NO_ROOT: "no admissible root was found",
    Status.INACCURATE: "the root found does not satisfy the law to the local tolerance",
    Status.NOT_FINITE: "the answer is not finite",
}


@dataclass(frozen=True)
class Option:
    """An option of a local solver: its default and one line that says what it does."""

    default: float
    meaning: str


class Declared:
    """What declarations of local solvers and of global methods share: options, and a law that may be one of them."""

    options: Mapping[str, Option]
    facets: int | str

    def option_values(self, given: Mapping[str, float]) -> NDArray[np.float64]:
        """Option values in declared order; raises `ValueError` on a name that is not declared, and on NaN."""
        unknown = sorted(set(given) - set(self.options))
        if unknown:
            known = ", ".join(self.options) or "none"
            raise ValueError(f"unknown option {unknown[0]!r} (known: {known})")
        if wrong := [name for name, value in given.items() if math.isnan(value)]:
            raise ValueError(f"option {wrong[0]!r} is not a number")
        return np.array([float(given.get(name, o.default)) for name, o in self.options.items()])

    def law(self, given: Mapping[str, float]) -> int:
        """Number of facets of the law solved under these options, 0 for Coulomb's.

        Raises `ValueError` unless the polygon has an integer number of at least three facets.
        """
        if not isinstance(self.facets, str):
            return self.facets
        facets = given.get(self.facets, self.options[self.facets].default)
        if not 3 <= facets < math.inf or facets != int(facets):
            raise ValueError(f"option {self.facets!r} must be an integer >= 3, not {facets:g}")
        return int(facets)


@dataclass(frozen=True)
class LocalSolver(Declared):
    """A kernel with its declaration. `facets` says which law it solves, `exact` what a claim of it is worth.

    `facets` is a number (0: Coulomb's law), or the name of the option that holds it. With `exact=False` a visit is
    a step towards the answer and `CONVERGED` no claim. A solver with a fall-back may declare what it tries `first`,
    as a kernel: it is asked again afterwards, to tell where the fall-back was used.

    A solver that is to be fast may declare how `several` contacts are solved at once, as a kernel of the same form on
    `Lanes` (see `fibercontact.lanes`), which returns `(done, r, iterations)`. Where `done` is 1 the kernel would have
    ended in `CONVERGED` with this impulse, bit for bit; where it is 0 the kernel is asked.
    """

    kernel: Any
    options: Mapping[str, Option] = field(default_factory=dict)
    facets: int | str = COULOMB
    exact: bool = True
    first: Any = None
    several: Any = None
