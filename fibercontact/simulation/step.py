"""One step of a scene: detect, differentiate, assemble, condense, solve, move."""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_array, csr_array
from scipy.spatial import KDTree

from fibercontact.contact.assemble import ContactSystem, assemble, obstacle_drift
from fibercontact.contact.detect import Contacts, detect
from fibercontact.contact.obstacles import Obstacle
from fibercontact.errors import UserError
from fibercontact.gauss_seidel.anderson import Acceleration
from fibercontact.gauss_seidel.solver import GaussSeidel, Run
from fibercontact.local.registry import configure, registered
from fibercontact.problem.step import StepProblem
from fibercontact.rods.dynamics import advance, step_system
from fibercontact.rods.kinematics import centreline, point_jacobian, prescribed_velocity
from fibercontact.rods.model import RootMotion, State
from fibercontact.simulation.scene import Body, Motion, Scene

__all__ = ["SimulationError", "Step", "World", "simulate", "start"]

Array = NDArray[np.float64]


class SimulationError(UserError):
    """A simulation that cannot go on; the message says when and why."""


@dataclass(frozen=True)
class World:
    """The state of a scene at a time: rods, bodies, and the contact impulses of the step that led to it."""

    time: float
    state: State
    bodies: tuple[Body, ...]
    contacts: Contacts | None = None
    impulses: Array | None = None  # (n, 3) N·s, world axes, on A


@dataclass(frozen=True)
class Step:
    """One step: the problem it posed (None without contact), the guess it started from, and its answer."""

    index: int
    world: World  # at the end of the step
    contacts: Contacts
    problem: StepProblem | None
    guess: Array  # (3n,)
    run: Run | None
    seconds: float


def start(scene: Scene) -> World:
    """The world at time 0."""
    return World(0.0, scene.state, tuple(scene.bodies))


def simulate(scene: Scene) -> Iterator[Step]:
    """Run a scene step by step. The same scene gives the same steps, bit for bit, on the same machine."""
    solver = GaussSeidel(
        configure("secular", registered()),
        tolerance=scene.tolerance,
        max_sweeps=scene.max_sweeps,
        proximal=0.05,
        acceleration=Acceleration(),
    )
    world = start(scene)
    for index in range(scene.steps):
        step = take_step(scene, solver, world, index)
        yield step
        world = step.world


def take_step(scene: Scene, solver: GaussSeidel, world: World, index: int) -> Step:
    """Advance a world by one step of its scene; raises `SimulationError` when the motion has blown up."""
    began = time.perf_counter()
    end = world.time + scene.dt
    motions = [body.motion(end) for body in world.bodies]
    obstacles = _moving_obstacles(world.bodies, motions)
    roots = _root_motion(scene, world, motions)
    M, f = step_system(scene.rods, world.state, roots, scene.gravity(end), scene.dt)
    if not (np.isfinite(M).all() and np.isfinite(f).all()):
        raise SimulationError(f"{scene.name}: the motion blew up at {world.time:g} s; take a smaller dt")
    contacts = detect(
        centreline(scene.rods, world.state, scene.segments), scene.rods.length, scene.rods.radius,
        margin=scene.margin, skip_root=scene.skip_root, obstacles=obstacles,
    )  # fmt: skip
    if len(contacts.gap) == 0:
        v = np.asarray(np.linalg.solve(M, -f[:, :, None])[:, :, 0], dtype=np.float64)
        nothing = np.zeros(0)
        moved = _moved(scene, world, v, roots, motions, contacts, np.zeros((0, 3)))
        return Step(index, moved, contacts, None, nothing, None, time.perf_counter() - began)
    system = _contact_system(scene, world.state, contacts, obstacles, roots)
    mu = np.where(contacts.obstacle < 0, scene.mu_fibres, scene.mu_obstacles).astype(float)
    problem = StepProblem(_block_diagonal(M), f.ravel(), system.H, system.w, mu)
    guess = _guess(world, contacts, system.frames)
    run = solver.solve(problem.condense(), guess)
    v = problem.velocities(run.r).reshape(f.shape)
    impulses = np.einsum("nji,nj->ni", system.frames, run.r.reshape(-1, 3))
    moved = _moved(scene, world, v, roots, motions, contacts, impulses)
    return Step(index, moved, contacts, problem, guess, run, time.perf_counter() - began)


def _moved(
    scene: Scene,
    world: World,
    v: Array,
    roots: RootMotion,
    motions: list[Motion],
    contacts: Contacts,
    impulses: Array,
) -> World:
    """The world at the end of the step."""
    state = advance(scene.rods, world.state, v, roots, scene.dt)
    bodies = tuple(
        replace(
            body,
            pivot=body.pivot + scene.dt * motion.velocity,
            obstacles=[moving.moved(scene.dt) for moving in _of_body(body, motion)],
        )
        for body, motion in zip(world.bodies, motions, strict=True)
    )
    return World(world.time + scene.dt, state, bodies, contacts, impulses)


def _contact_system(
    scene: Scene, state: State, contacts: Contacts, obstacles: list[Obstacle], roots: RootMotion
) -> ContactSystem:
    """The Jacobians of both sides of every contact, assembled; side B of an obstacle is not read."""
    fibre_b = np.maximum(contacts.fibre_b, 0)
    a = point_jacobian(scene.rods, state, contacts.fibre_a, contacts.s_a)
    b = point_jacobian(scene.rods, state, fibre_b, contacts.s_b)
    drift_a = prescribed_velocity(scene.rods, state, roots, contacts.fibre_a, a.position)
    drift_b = np.where(
        contacts.obstacle[:, None] < 0,
        prescribed_velocity(scene.rods, state, roots, fibre_b, b.position),
        obstacle_drift(contacts, obstacles),
    )
    return assemble(
        contacts, a.jacobian, b.jacobian, drift_a, drift_b, dt=scene.dt, rods=len(scene.rods.length)
    )


def _of_body(body: Body, motion: Motion) -> list[Obstacle]:
    """The obstacles of a body, with the velocities that the body's motion gives them."""
    return [
        replace(
            obstacle,
            velocity=motion.velocity + np.cross(motion.angular_velocity, obstacle.point - body.pivot),
            angular_velocity=motion.angular_velocity,
        )
        for obstacle in body.obstacles
    ]


def _moving_obstacles(bodies: tuple[Body, ...], motions: list[Motion]) -> list[Obstacle]:
    return [o for body, motion in zip(bodies, motions, strict=True) for o in _of_body(body, motion)]


def _root_motion(scene: Scene, world: World, motions: list[Motion]) -> RootMotion:
    """Motion of the roots at the end of the step; accelerations are what changes it over the step."""
    before = [body.motion(world.time) for body in world.bodies]
    pivot = np.array([body.pivot for body in world.bodies])[scene.carrier]
    arm = world.state.root_position - pivot

    def of_roots(body_motions: list[Motion]) -> tuple[Array, Array]:
        of_bodies = (np.array(x) for x in zip(*body_motions, strict=True))
        velocity, omega = (x[scene.carrier] for x in of_bodies)
        return velocity + np.cross(omega, arm), omega

    (velocity, omega), (old_velocity, old_omega) = of_roots(motions), of_roots(before)
    centripetal = np.cross(omega, np.cross(omega, arm))
    return RootMotion(
        velocity,
        omega,
        (velocity - old_velocity) / scene.dt + centripetal,
        (omega - old_omega) / scene.dt,
    )


def _block_diagonal(M: Array) -> csr_array:
    """One block a rod; symmetric bit for bit, so that a file holds the very problem that was solved."""
    R, D, _ = M.shape
    return bsr_array(
        (0.5 * (M + M.transpose(0, 2, 1)), np.arange(R), np.arange(R + 1)), shape=(R * D, R * D)
    ).tocsr()


def _guess(world: World, contacts: Contacts, frames: Array) -> Array:
    """Impulses of the last step carried to the contacts of this one: the same bodies, the nearest point."""
    guess = np.zeros((len(contacts.gap), 3))
    last = world.contacts
    if last is None or world.impulses is None or len(last.gap) == 0:
        return guess.ravel()
    distance, nearest = KDTree(_signature(last)).query(_signature(contacts), distance_upper_bound=1.0)
    found = np.isfinite(distance)
    guess[found] = np.einsum("nij,nj->ni", frames[found], world.impulses[np.asarray(nearest)[found]])
    return guess.ravel()


def _signature(contacts: Contacts) -> Array:
    """Points whose distance is below 1 only for contacts of the same bodies within 1 cm along both fibres."""
    bodies = np.column_stack([contacts.fibre_a, contacts.fibre_b, contacts.obstacle]) * 10.0
    return np.column_stack([bodies, contacts.s_a / 0.01, contacts.s_b / 0.01])
