"""Scenes of one rod and an obstacle whose outcome is known from elsewhere, for every rod model: `MODELS`.

The plane of bending is that of x and z, z upwards. Discrete rods have rigid edges: a rod thick and soft enough for
these scenes would stretch.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fibercontact.contact.obstacles import Obstacle
from fibercontact.rods import (
    CLOTHOID,
    HELIX,
    circular_rods,
    discrete_rods,
    discrete_state,
    rest_state,
)
from fibercontact.rods.interface import AnyRods, AnyState, rod_model
from fibercontact.simulation.scene import STILL, Body, Motion, Scene
from fibercontact.simulation.step import Step

Array = NDArray[np.float64]
MODELS = ("Super-Helix", "Super-Clothoid", "Discrete rod")


class Rod(NamedTuple):
    """A naturally straight or circular rod of circular section, and the curvature it starts with."""

    length: float = 1.0
    radius: float = 2e-3
    bending: float = 1.0  # EI
    line_density: float = 1.0  # rho S
    rest_curvature: float = 0.0  # in the plane, towards n_1
    turned: Callable[[Array], Array] | None = None  # angle it turns by up to s; None: its natural arc
    damping: float = 0.0
    free: bool = False
    position: Sequence[float] = (0.0, 0.0, 0.0)
    angle: float = 0.0  # of the root's tangent above the x axis, towards z

    def build(self, model: str, elements: int, frame: Array | None = None) -> tuple[AnyRods, AnyState]:
        """The rod and its initial state; `frame` is that of the root, in the plane by default."""
        material = {
            "length": self.length,
            "radius": self.radius,
            "young": 4 * self.bending / (np.pi * self.radius**4),
            "poisson": 0.5,
            "density": self.line_density / (np.pi * self.radius**2),
            "damping": self.damping,
            "free": self.free,
            "curvature": (0.0, 0.0, self.rest_curvature),
        }
        frame = in_plane(self.angle) if frame is None else frame
        if model == "Discrete rod":
            rods = discrete_rods(edges=elements, inextensible=True, **material)
            return rods, discrete_state(rods, self.position, frame, self._means(self._cells(elements)))
        basis = CLOTHOID if model == "Super-Clothoid" else HELIX
        rods = circular_rods(elements=elements, basis=basis, **material)
        state = rest_state(rods, self.position, frame)
        bounds = np.arange(elements + 1) / elements
        if basis == CLOTHOID:  # a node stands for the halves of elements beside it
            bounds = np.clip((np.arange(elements + 2) - 0.5) / elements, 0, 1)
        return rods, state._replace(q=self._means(bounds)[None])

    def _cells(self, edges: int) -> Array:
        bounds = (np.arange(edges) + 0.5) / edges
        return np.concatenate([[bounds[0] if self.free else 0.0], bounds[1:]])

    def _means(self, bounds: Array) -> Array:
        """Mean initial curvatures (m, 3) between `bounds` (m + 1,), in lengths."""
        s = self.length * bounds
        turned = self.rest_curvature * s if self.turned is None else self.turned(s)
        bend = np.diff(turned) / np.diff(s)
        return np.column_stack([0 * bend, 0 * bend, bend])


def in_plane(angle: float) -> Array:
    """Frame whose tangent rises by `angle` from the x axis, n_1 in the plane, on the left."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [0.0, 0.0, -1.0], [s, c, 0.0]])


def scene(
    rods: AnyRods,
    state: AnyState,
    obstacle: Obstacle,
    *,
    mu: float,
    dt: float,
    steps: int,
    gravity: Sequence[float] = (0.0, 0.0, 0.0),
    clamp: Callable[[float], Motion] = lambda time: STILL,
    obstacle_motion: Callable[[float], Motion] = lambda time: STILL,
    **options: float,
) -> Scene:
    """A scene of rods whose roots a clamp holds, and of one obstacle with its own motion."""
    weight = np.array(gravity)
    return Scene(
        name="validation",
        description="Rods and one obstacle.",
        rods=rods,
        state=state,
        bodies=[Body(np.zeros(3), clamp), Body(obstacle.point, obstacle_motion, [obstacle])],
        carrier=np.zeros(len(rods.length), dtype=np.int64),
        dt=dt,
        steps=steps,
        mu_fibres=0.0,
        mu_obstacles=mu,
        gravity=lambda time: weight,
        **options,
    )


def tip(scene: Scene, state: AnyState) -> Array:
    """Ends (R, 3) of the rods."""
    return rod_model(scene.rods).centreline(state, scene.segments)[:, -1]


def contact_force(step: Step, dt: float) -> Array:
    """Total force (3,) of the obstacle on the rods."""
    impulses = step.world.impulses
    return np.zeros(3) if impulses is None else impulses.sum(axis=0) / dt


def contact_work(step: Step) -> Array:
    """Work (n, 2) of the normal and the tangential impulse at each contact with a fixed obstacle.

    Impulses act on the velocities at the end of the step, like those of the law that they obey.
    """
    if step.problem is None or step.run is None:
        return np.zeros((0, 2))
    r, u = (x.reshape(-1, 3) for x in (step.run.r, step.problem.H @ step.problem.velocities(step.run.r)))
    return np.column_stack([r[:, 0] * u[:, 0], np.sum(r[:, 1:] * u[:, 1:], axis=1)])


def total_energy(scene: Scene, state: AnyState) -> tuple[float, float, float]:
    """Kinetic, elastic and gravitational energy of all rods."""
    energy = rod_model(scene.rods).energy(state, scene.gravity(0.0))
    return float(energy.kinetic.sum()), float(energy.elastic.sum()), float(energy.gravitational.sum())
