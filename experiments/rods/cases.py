"""What a validation without contact asks of a rod: a case.

The rods are dimensionless: length, bending stiffness EI and mass per unit length are 1, the twist stiffness
GJ is 1/(1 + POISSON). A weight of Gamma = rho S g L³/EI is a gravity of Gamma; a curvature is in turns of
1/L radians. Roots are clamped at the origin with the frame of the world: the tangent is x, n_1 is y, n_2 is z.
"""

from typing import NamedTuple, Self

import numpy as np

POISSON, RADIUS = 0.5, 0.01


class Case(NamedTuple):
    """What an equilibrium depends on: the rest curvature `(tau, kappa_1, kappa_2)` and gravity."""

    curvature: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def halfway(self, other: Self) -> "Case":
        """The case in the middle of two."""
        return Case(*(tuple(np.add(a, b) / 2) for a, b in zip(self, other, strict=True)))
