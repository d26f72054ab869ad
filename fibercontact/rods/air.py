"""Drag of the air on thin rods, linear in the velocity of the rod relative to the wind.

    force per length = −C (v − wind),     C = normal (I − t tᵀ) + tangential t tᵀ

A step takes C where the rods are at its beginning and v at its end: `M` gains the symmetric, positive
semi-definite `dt ∫ Jᵀ C J ds`, so that no drag is too strong for a step, and f what wind and prescribed roots give.
Sections that spin about their tangent feel nothing.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

__all__ = ["AIR", "Drag", "slender_drag"]

Array = NDArray[np.float64]

AIR = 1.8e-5
"""Viscosity of air at room temperature, Pa s."""


@dataclass(frozen=True)
class Drag:
    """Drag coefficients across and along rods, kg/(m s), and the wind (3,) in m/s.

    ValueError when a coefficient is negative, or anything is not finite.
    """

    normal: float
    tangential: float
    wind: Array = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        for name in ("normal", "tangential"):
            value = getattr(self, name)
            if not 0 <= value < math.inf:
                raise ValueError(f"{name} drag must be finite and not negative, not {value}")
        if np.shape(self.wind) != (3,) or not np.isfinite(self.wind).all():
            raise ValueError(f"wind must be a finite vector (3,), not {self.wind}")

    def resistance(self, tangent: Array) -> Array:
        """The matrices C (…, 3, 3) of unit tangents (…, 3)."""
        along = tangent[..., :, None] * tangent[..., None, :]
        return self.normal * np.eye(3) + (self.tangential - self.normal) * along


def slender_drag(length: float, radius: float, viscosity: float = AIR) -> tuple[float, float]:
    """Normal and tangential drag, kg/(m s), of a straight cylinder alone in a viscous fluid.

    `4 pi viscosity/(ln(2 L/r) − 1/2)` and `2 pi viscosity/(ln(2 L/r) − 3/2)`, length L and radius r in m, viscosity
    in Pa s: the mean over the length, to second order in `1/ln(2 L/r)` [Batchelor 1970, Cox 1970, J. Fluid Mech. 44].
    Inertia of the fluid is left out, so `density · speed · L / viscosity` should be below 1; faster flow drags
    more than this. ValueError when the cylinder is not slender, `L < 10 r`, or a number is not positive.

    >>> [f"{c:.2e}" for c in slender_drag(length=0.15, radius=4e-5)]
    ['2.69e-05', '1.52e-05']
    """
    if not (0 < radius <= length / 10 < math.inf and 0 < viscosity < math.inf):
        raise ValueError(
            f"need viscosity > 0 and length ≥ 10 radius > 0, not {viscosity}, {length} and {radius}"
        )
    logarithm = math.log(2 * length / radius)
    return 4 * math.pi * viscosity / (logarithm - 0.5), 2 * math.pi * viscosity / (logarithm - 1.5)
