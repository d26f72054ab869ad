"""What a validation without contact asks of a rod: a case, and how equilibria are followed from case to case.

The rods are dimensionless: length, bending stiffness EI and mass per unit length are 1, the twist stiffness
GJ is 1/(1 + POISSON). A weight of Gamma = rho S g L³/EI is a gravity of Gamma; a curvature is in turns of
1/L radians. Roots are clamped at the origin with the frame of the world: the tangent is x, n_1 is y, n_2 is z.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, Protocol, Self, TypeVar

import numpy as np

POISSON, RADIUS = 0.5, 0.01
MATERIAL = {
    "length": 1.0,
    "radius": RADIUS,
    "young": 4 / (np.pi * RADIUS**4),
    "poisson": POISSON,
    "density": 1 / (np.pi * RADIUS**2),
}
_HALVINGS = 8  # of the way between two cases


class Case(NamedTuple):
    """What an equilibrium depends on: the rest curvature `(tau, kappa_1, kappa_2)` and gravity."""

    curvature: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def halfway(self, other: Self) -> "Case":
        """The case in the middle of two."""
        return Case(*(tuple(np.add(a, b) / 2) for a, b in zip(self, other, strict=True)))


class _Balance(Protocol):
    @property
    def case(self) -> Case: ...


B = TypeVar("B", bound=_Balance)


def follow(path: Sequence[Case], start: B, near: Callable[[Case, B], B | None]) -> Iterator[B]:
    """Equilibria along a path of cases, each from the one before; `near` finds one from another, or does not."""
    for case in path:
        start = _reach(case, start, near, _HALVINGS)
        yield start


def _reach(case: Case, start: B, near: Callable[[Case, B], B | None], halvings: int) -> B:
    """The equilibrium of a case, by way of the middle when `near` does not find it from `start`."""
    if (found := near(case, start)) is not None:
        return found
    if halvings == 0:
        raise RuntimeError(f"no equilibrium of {case} was found")
    middle = _reach(start.case.halfway(case), start, near, halvings - 1)
    return _reach(case, middle, near, halvings - 1)
