"""What a scene is: rods, rigid bodies that carry their roots and the obstacles, and the physics' constants."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fibercontact.contact.obstacles import Obstacle
from fibercontact.errors import UserError
from fibercontact.rods.air import Drag
from fibercontact.rods.interface import AnyRods, AnyState

__all__ = ["STILL", "Air", "Body", "Motion", "Scene", "SceneError", "calm", "earth"]

Array = NDArray[np.float64]


class SceneError(UserError):
    """A scene that is not known or cannot be built; the message says why."""


class Motion(NamedTuple):
    """Velocity (3,) in m/s of a body's pivot, and its angular velocity (3,) in rad/s, world axes."""

    velocity: Array
    angular_velocity: Array


STILL = Motion(np.zeros(3), np.zeros(3))


def earth(time: float) -> Array:
    """Gravity (3,) in m/s² that does not change, downwards along z."""
    return np.array([0.0, 0.0, -9.81])


def calm(time: float) -> Array:
    """No wind (3,), m/s."""
    return np.zeros(3)


@dataclass(frozen=True)
class Air:
    """Air that drags on the rods with coefficients across and along them, kg/(m s); `wind` (3,) in m/s.

    ValueError when a coefficient is negative, or anything is not finite.
    """

    normal: float
    tangential: float
    wind: Callable[[float], Array] = calm

    def __post_init__(self) -> None:
        self.drag(0.0)

    def drag(self, time: float) -> Drag:
        """Its drag at a time."""
        return Drag(self.normal, self.tangential, self.wind(time))


@dataclass(frozen=True)
class Body:
    """A rigid body that moves obstacles and clamped roots: its `pivot` at time 0 and its motion in time."""

    pivot: Array
    motion: Callable[[float], Motion] = lambda time: STILL
    obstacles: Sequence[Obstacle] = ()


@dataclass(frozen=True)
class Scene:
    """A simulation that can be run: SI units throughout.

    `carrier` (R,) is the body that each clamped root is fixed to. `gravity` is a function of time; without
    `air` there is no drag. Contacts between fibres have the friction `mu_fibres`, those with obstacles
    `mu_obstacles`. The polylines of contact detection have `segments` segments, or are the edges of discrete rods;
    `margin` and `skip_root` are those of `contact.detect`. Raises `SceneError` naming what does not fit.
    """

    name: str
    description: str
    rods: AnyRods
    state: AnyState
    bodies: Sequence[Body]
    carrier: NDArray[np.int64]
    dt: float
    steps: int
    mu_fibres: float
    mu_obstacles: float
    gravity: Callable[[float], Array] = earth
    segments: int = 20
    margin: float = 0.2
    skip_root: float = 0.0
    tolerance: float = 1e-4
    max_sweeps: int = 1000
    air: Air | None = None

    def __post_init__(self) -> None:
        R = len(self.rods.length)
        _require(bool(self.bodies), "bodies: there is none, not even one at rest for the roots")
        _require(
            np.shape(self.carrier) == (R,) and bool(np.isin(self.carrier, range(len(self.bodies))).all()),
            f"carrier: needs the index of one of the {len(self.bodies)} bodies for each of the {R} rods",
        )
        _require(0 < self.dt < math.inf, f"dt: must be positive and finite, not {self.dt!r}")
        for name in ("steps", "segments", "max_sweeps"):
            count = getattr(self, name)
            _require(count >= 1, f"{name}: must be at least 1, not {count!r}")
        for name in ("mu_fibres", "mu_obstacles", "margin", "skip_root", "tolerance"):
            value = getattr(self, name)
            _require(0 <= value < math.inf, f"{name}: must be finite and not negative, not {value!r}")


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise SceneError(message)
