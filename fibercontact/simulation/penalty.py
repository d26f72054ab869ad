"""Explicit penalty contact, the model that the talk argues against (THEORY §6).

Contacts that overlap are springs, with dashpots and friction, whose forces are known before the step:

    r_N = max(0, −stiffness gap − damping u_N),     r_T = −mu r_N u_T/‖u_T‖,

with the relative velocities u at its beginning (u_N > 0 when the contact opens, so `damping` is −nu of THEORY).
Nothing is solved. What is wrong with it is measured by `experiments/penalty.py`:

* No threshold. At u_T = 0 there is no friction, and the force does not depend on ‖u_T‖: a rod that should
  stick on a slope jumps to and fro across zero, about a mean that is not zero. The usual remedy, `slip_speed`,
  lets friction grow in proportion below that speed, and creeps at a share of it.
* Small steps. A mass m on one contact is stable for `dt² stiffness + 2 dt damping < 4 m` only; flexible rods
  and many contacts on a rod have less.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fibercontact.errors import UserError
from fibercontact.simulation.scene import Scene

__all__ = ["Penalty", "penalty_for"]

Array = NDArray[np.float64]

OVERLAP = 0.01  # of the radius, under the weight of a rod
DAMPING_RATIO = 0.1
GRAVITY = 9.81  # m/s²


@dataclass(frozen=True)
class Penalty:
    """Stiffness in N/m and damping in N s/m of every contact; friction is full above the `slip_speed` in m/s.

    Raises `UserError` when the stiffness is not positive, another number is negative, or one is not finite.
    """

    stiffness: float
    damping: float = 0.0
    slip_speed: float = 0.0

    def __post_init__(self) -> None:
        if not 0 < self.stiffness < math.inf:
            raise UserError(f"penalty stiffness must be positive and finite, not {self.stiffness}")
        for name in ("damping", "slip_speed"):
            value = getattr(self, name)
            if not 0 <= value < math.inf:
                raise UserError(f"penalty {name} must be finite and not negative, not {value}")

    def forces(self, gap: Array, u: Array, mu: Array) -> Array:
        """Forces (n, 3) in N on A, in the contacts' frames, from gaps (n,) in m and velocities u (n, 3) in m/s."""
        normal = np.maximum(0.0, -self.stiffness * gap - self.damping * u[:, 0])
        normal[gap >= 0] = 0.0
        speed = np.maximum(np.linalg.norm(u[:, 1:], axis=1), self.slip_speed)
        share = np.divide(mu * normal, speed, out=np.zeros_like(speed), where=speed > 0)
        return np.column_stack([normal, -share[:, None] * u[:, 1:]])


def penalty_for(scene: Scene, stiffness: float | None = None) -> Penalty:
    """Penalty by rule of thumb: the weight of the heaviest rod presses a contact in by 1 % of a radius.

    The damping is a tenth of what is critical for the mass of that rod on one contact, for any `stiffness`.
    """
    mass = float((scene.rods.line_density * scene.rods.length).max())
    k = mass * GRAVITY / (OVERLAP * float(scene.rods.radius.min())) if stiffness is None else stiffness
    return Penalty(k, 2 * DAMPING_RATIO * math.sqrt(max(k, 0.0) * mass))
