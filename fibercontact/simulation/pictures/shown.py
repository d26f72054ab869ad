"""What is shown of a step: fibres, obstacles, and contacts with their regimes and forces."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fibercontact.contact.detect import Contacts
from fibercontact.contact.obstacles import Cylinder, Obstacle, Sphere
from fibercontact.gauss_seidel.sweep import regime
from fibercontact.local.algebra import OPEN, SLIP, STICK
from fibercontact.rods.interface import AnyRods, rod_model
from fibercontact.simulation.scene import Scene
from fibercontact.simulation.step import Step
from fibercontact.simulation.strands import cap

__all__ = ["REGIMES", "Regime", "Shown", "force_scale", "held", "regimes", "show"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

POINTS = 60  # segments of a fibre, unless its model has its own
ROUND = 1000  # points on a sphere
LONGEST = 0.08  # of the picture: a force that hardly any exceeds
HARDLY_ANY = 98.0  # per cent of the forces that are weaker


class Regime(NamedTuple):
    """Name of a regime, and the colours of its dots."""

    name: str
    colour: str
    edge: str


REGIMES = {
    STICK: Regime("stick", "#0072b2", "#ffffff"),
    SLIP: Regime("slip", "#d55e00", "#ffffff"),
    OPEN: Regime("take-off", "#ffffff", "#404040"),
}
"""From Okabe and Ito's palette, to be told apart by colour-blind readers."""


def regimes(r: Array, mu: Array) -> Ints:
    """Regimes (n,) of impulses `r` (3n,), by the definition of the sweeps.

    Take-off is without a normal impulse, stick strictly in the cone, slip at its boundary: all of it if mu = 0.
    """
    return np.array([regime(tuple(x), m) for x, m in zip(r.reshape(-1, 3), mu, strict=True)], dtype=np.int64)


@dataclass(frozen=True)
class Shown:
    """A step as it is drawn: R fibres at its end, n contacts."""

    index: int
    time: float  # s
    fibres: Array  # (R, P + 1, 3) m
    radius: Array  # (R,) m
    obstacles: Sequence[Obstacle]
    points: Array  # (n, 3) m, where the touching points are at the end of the step
    regime: Ints  # (n,)
    force: Array  # (n, 3) N on the first fibre, mean of the step

    def count(self, regime: int) -> int:
        """Number of contacts in a regime."""
        return int((self.regime == regime).sum())


def show(scene: Scene, step: Step) -> Shown:
    """What is shown of a step of a scene."""
    world, contacts = step.world, step.contacts
    fibres = rod_model(scene.rods).centreline(world.state, POINTS)
    radius = np.broadcast_to(np.asarray(scene.rods.radius, dtype=float), (len(fibres),))
    assert world.impulses is not None
    if step.run is None or step.problem is None:  # penalty's friction always slides
        regime = np.where(world.impulses.any(axis=1), SLIP, OPEN)
    else:
        regime = regimes(step.run.r, step.problem.mu)
    return Shown(
        index=step.index,
        time=world.time,
        fibres=fibres,
        radius=radius,
        obstacles=[obstacle for body in world.bodies for obstacle in body.obstacles],
        points=_contact_points(fibres, scene.rods, contacts),
        regime=regime,
        force=world.impulses / scene.dt,
    )


def _contact_points(fibres: Array, rods: AnyRods, contacts: Contacts) -> Array:
    """Points (n, 3) halfway between the surfaces that touch, for polylines (R, P + 1, 3).

    Contacts are found at the beginning of a step: this is where the same material points are now, on polylines
    of equal steps in arc-length. With an obstacle it is the point of the fibre's surface.
    """
    radius = np.broadcast_to(np.asarray(rods.radius, dtype=float), (len(fibres),))
    a, b = contacts.fibre_a, np.maximum(contacts.fibre_b, 0)
    surface_a = _at(fibres, rods.length, a, contacts.s_a) - radius[a, None] * contacts.normal
    surface_b = _at(fibres, rods.length, b, contacts.s_b) + radius[b, None] * contacts.normal
    return np.where(contacts.obstacle[:, None] < 0, 0.5 * (surface_a + surface_b), surface_a)


def _at(fibres: Array, length: Array, rod: Ints, s: Array) -> Array:
    """Points (n, 3) of polylines at arc-lengths (n,)."""
    segments = fibres.shape[1] - 1
    x = np.clip(s / length[rod], 0.0, 1.0) * segments
    k = np.minimum(x.astype(np.int64), segments - 1)
    return fibres[rod, k] + (x - k)[:, None] * (fibres[rod, k + 1] - fibres[rod, k])


def held(shown: Shown) -> list[Array]:
    """Groups of points (m, 3) that a picture must hold: the fibres, and the obstacles that end somewhere."""
    surfaces = [_surface(obstacle) for obstacle in shown.obstacles]
    return [shown.fibres.reshape(-1, 3), *(points for points in surfaces if len(points))]


def _surface(obstacle: Obstacle) -> Array:
    """Points all over the outside of an obstacle, none where it has no end."""
    if isinstance(obstacle, Sphere):
        return obstacle.point + obstacle.radius * cap(ROUND, share=2.0)
    if isinstance(obstacle, Cylinder) and np.isfinite(obstacle.length):
        half = 0.5 * obstacle.length * obstacle.axis
        balls = obstacle.radius * cap(ROUND, share=2.0) + np.stack([-half, half])[:, None]
        return obstacle.point + balls.reshape(-1, 3)
    return np.empty((0, 3))


def force_scale(frames: Iterable[Shown], width: float) -> float:
    """Metres that a newton is drawn long in pictures `width` m wide; 0 without forces."""
    strength = np.concatenate([np.linalg.norm(shown.force, axis=1) for shown in frames])
    strong = strength[strength > 0.0]
    return LONGEST * width / float(np.percentile(strong, HARDLY_ANY)) if len(strong) else 0.0
