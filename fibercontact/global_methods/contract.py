"""What a global method is: it takes a whole problem, where a local solver takes one contact.

A global method answers `u = W r + b` with its law at every contact, in whatever way it likes. It is plain Python (its
kernels may be compiled):

    solve(system, task, options) -> Answer

`system` is the problem laid out in block rows (`velocity(system, r, u)` is the product with `W`), `options` a float64
array in the order of the declared options. Only the impulses of the answer are believed, once they are measured.

What every method owes: the same input gives the same bits (the clock aside); it does not write to `system`,
`task.start` or `options`; it looks at the clock, for it is killed some seconds after its time; `claimed` is said only
of impulses whose residual meets the tolerance.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fibercontact.errors import UserError
from fibercontact.gauss_seidel.blocks import BlockSystem
from fibercontact.local.contract import Declared, Option
from fibercontact.problem.cone import COULOMB

__all__ = ["Answer", "GlobalMethod", "Solve", "Task", "Unsuited"]

Array = NDArray[np.float64]


class Unsuited(UserError):  # noqa: N818
    """Raised by a method that does not take a problem, too large a one for instance; the row says why."""


class Task(NamedTuple):
    """What a method is asked."""

    tolerance: float  # on the residual of THEORY §2, relative to b (absolute where b = 0)
    b_ref: float  # size of b, m/s; 0 where b = 0
    max_iterations: int
    max_seconds: float  # the method looks at the clock itself; it is killed some seconds later
    start: Array | None = None  # (3n,) impulse in N·s, zero by default

    @property
    def target(self) -> float:
        """The residual to reach, in the unit of b."""
        return self.tolerance * (self.b_ref or 1.0)


@dataclass(frozen=True)
class Answer:
    """What a method says: its impulses, and its own account of them.

    `claimed`: by its own account they meet the tolerance. `residual` is relative to b, by its own measure. `seconds`
    is the time of the solve by its own clock, None for the harness's. `note` is a sentence on why it stopped.
    """

    r: Array  # (3n,) N·s
    claimed: bool
    iterations: int
    residual: float = math.nan
    seconds: float | None = None
    note: str = ""


Solve = Callable[[BlockSystem, Task, Array], Answer]


@dataclass(frozen=True)
class GlobalMethod(Declared):
    """A method with its declaration.

    `facets` says which law it solves, a number (0: Coulomb's) or the name of the option that holds it. `prepare` is
    called once in a process before any clock starts: to compile kernels, or to start what the method talks to.
    """

    solve: Solve
    options: Mapping[str, Option] = field(default_factory=dict)
    facets: int | str = COULOMB
    prepare: Callable[[], object] | None = None
