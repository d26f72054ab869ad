"""How rigid bodies move the obstacles and the clamped roots that they carry, over a step."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fibercontact.rods.model import RootMotion
from fibercontact.simulation.scene import Body, Motion

__all__ = ["in_motion", "moved", "root_motion"]

Array = NDArray[np.float64]


def in_motion(body: Body, motion: Motion) -> Body:
    """The body whose obstacles have the velocities that its motion gives them."""
    obstacles = [
        replace(
            obstacle,
            velocity=motion.velocity + np.cross(motion.angular_velocity, obstacle.point - body.pivot),
            angular_velocity=motion.angular_velocity,
        )
        for obstacle in body.obstacles
    ]
    return replace(body, obstacles=obstacles)


def moved(body: Body, motion: Motion, dt: float) -> Body:
    """A body `in_motion` after a step."""
    obstacles = [obstacle.moved(dt) for obstacle in body.obstacles]
    return replace(body, pivot=body.pivot + dt * motion.velocity, obstacles=obstacles)


def root_motion(
    roots: Array,
    carrier: NDArray[np.int64],
    bodies: Sequence[Body],
    before: Sequence[Motion],
    after: Sequence[Motion],
    dt: float,
) -> RootMotion:
    """Motion of roots (R, 3) at the end of a step; accelerations are what changes it over the step.

    `carrier` (R,) is the body of each root; the bodies' motions are those `before` and `after` the step.
    """
    arm = roots - np.array([body.pivot for body in bodies])[carrier]

    def of_roots(motions: Sequence[Motion]) -> tuple[Array, Array]:
        velocity, omega = (np.array(x)[carrier] for x in zip(*motions, strict=True))
        return velocity + np.cross(omega, arm), omega

    (velocity, omega), (old_velocity, old_omega) = of_roots(after), of_roots(before)
    centripetal = np.cross(omega, np.cross(omega, arm))
    return RootMotion(velocity, omega, (velocity - old_velocity) / dt + centripetal, (omega - old_omega) / dt)
