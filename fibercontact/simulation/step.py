"""A scene in time. One step: detect, differentiate, assemble, condense, solve, move."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from fibercontact.contact.assemble import ContactSystem, assemble, obstacle_drift
from fibercontact.contact.detect import Contacts, detect
from fibercontact.contact.obstacles import Obstacle
from fibercontact.errors import UserError
from fibercontact.gauss_seidel.solver import LOOPS, GaussSeidel, Run
from fibercontact.local.registry import configure, registered
from fibercontact.problem.constrained import ConstrainedStep
from fibercontact.problem.step import StepProblem
from fibercontact.rods.interface import AnyState, RodModel, RodStep, System, rod_model
from fibercontact.simulation.bodies import in_motion, moved, root_motion
from fibercontact.simulation.penalty import Penalty
from fibercontact.simulation.scene import Body, Scene
from fibercontact.simulation.watch import Watch

__all__ = ["SimulationError", "Step", "World", "simulate", "start", "take_step"]

Array = NDArray[np.float64]


class SimulationError(UserError):
    """A simulation that cannot go on; the message says when and why."""


@dataclass(frozen=True)
class World:
    """The state of a scene at a time: rods, bodies, and the contact impulses of the step that led to it."""

    time: float
    state: AnyState
    bodies: tuple[Body, ...]
    contacts: Contacts | None = None
    impulses: Array | None = None  # (n, 3) N·s, world axes, on A


@dataclass(frozen=True)
class Step:
    """One step: the problem it posed (None without contact), the guess it started from, and its answer.

    When rods take more than one system a step, these are of the last one; its guess is the impulse of the one
    before. Penalty contact poses no problem: contacts and impulses are those of the world. `parts` are the seconds
    that each part of the step took (see `simulation.watch`).
    """

    index: int
    world: World  # at the end of the step
    contacts: Contacts
    problem: StepProblem | ConstrainedStep | None
    guess: Array  # (3n,)
    run: Run | None
    parts: Mapping[str, float]

    @property
    def seconds(self) -> float:
        """What the step took, s."""
        return sum(self.parts.values())


def start(scene: Scene) -> World:
    """The world at time 0."""
    return World(0.0, scene.state, tuple(scene.bodies))


def simulate(
    scene: Scene, world: World | None = None, first: int = 0, *, penalty: Penalty | None = None
) -> Iterator[Step]:
    """Run a scene step by step, from its start or from the `world` before the step `first`.

    With explicit `penalty` contact where it is given, with Coulomb's law otherwise. The same scene gives the same
    steps, bit for bit, on the same machine, wherever it is taken up.
    """
    contact = penalty or GaussSeidel(
        configure("secular", registered()),
        tolerance=scene.tolerance,
        max_sweeps=scene.max_sweeps,
        **LOOPS["accelerated"],
    )
    world = world or start(scene)
    for index in range(first, scene.steps):
        step = take_step(scene, contact, world, index)
        yield step
        world = step.world


def take_step(scene: Scene, contact: GaussSeidel | Penalty, world: World, index: int) -> Step:
    """Advance a world by one step of its scene; raises `SimulationError` when the motion has blown up."""
    watch = Watch()
    end = world.time + scene.dt
    motions = [body.motion(end) for body in world.bodies]
    bodies = [in_motion(body, motion) for body, motion in zip(world.bodies, motions, strict=True)]
    obstacles = [obstacle for body in bodies for obstacle in body.obstacles]
    before = [body.motion(world.time) for body in bodies]
    roots = root_motion(world.state.root_position, scene.carrier, bodies, before, motions, scene.dt)
    rods = rod_model(scene.rods)
    drag = None if scene.air is None else scene.air.drag(end)
    rod_step = rods.begin(world.state, roots, scene.gravity(end), scene.dt, drag)
    _check_finite(scene, world, rod_step)
    watch.lap("rods")
    contacts = detect(
        rods.centreline(world.state, scene.segments), scene.rods.length, scene.rods.radius,
        margin=scene.margin, skip_root=max(scene.skip_root, rods.held_length), obstacles=obstacles,
    )  # fmt: skip
    watch.lap("detection")
    if len(contacts.gap) == 0:
        rod_step = _without_contact(scene, world, rods, rod_step)
        answer = _Answer(rod_step, None, np.zeros(0), None, np.zeros((0, 3)))
    elif isinstance(contact, Penalty):
        answer = _with_penalty(scene, contact, world, rods, rod_step, contacts, obstacles)
    else:
        answer = _with_contact(scene, contact, world, rods, rod_step, contacts, obstacles, watch)
    there = tuple(moved(body, motion, scene.dt) for body, motion in zip(bodies, motions, strict=True))
    after = World(end, answer.rod_step.end(), there, contacts, answer.impulses)
    watch.lap("rods")
    return Step(index, after, contacts, answer.problem, answer.guess, answer.run, watch.seconds)


class _Answer(NamedTuple):
    """Where the rods go in a step, and the last problem on their way."""

    rod_step: RodStep
    problem: StepProblem | ConstrainedStep | None
    guess: Array  # (3n,)
    run: Run | None
    impulses: Array  # (n, 3) world axes


def _without_contact(
    scene: Scene, world: World, rods: RodModel, rod_step: RodStep, impulse: Array | float = 0.0
) -> RodStep:
    """Move rods under known impulses `Hᵀ r` (R, D)."""
    for _ in range(rods.iterations):
        _check_finite(scene, world, rod_step)
        v = rod_step.system.free_velocities(impulse)
        rod_step = rod_step.moved(v, np.broadcast_to(impulse, v.shape))
        if rod_step.converged:
            break
    return rod_step


def _with_penalty(
    scene: Scene,
    penalty: Penalty,
    world: World,
    rods: RodModel,
    rod_step: RodStep,
    contacts: Contacts,
    obstacles: list[Obstacle],
) -> _Answer:
    """Move rods under the forces that contacts have at the beginning of the step."""
    system = _contact_system(scene, rods, rod_step, contacts, obstacles, beta=0.0)
    shape = rod_step.system.f.shape
    v = world.state.v[:, -shape[1] :]  # prescribed dofs come first
    u = (system.H @ v.ravel() + system.w).reshape(-1, 3)
    r = scene.dt * penalty.forces(contacts.gap, u, _friction(scene, contacts))
    impulse = (system.H.T @ r.ravel()).reshape(shape)
    moved = _without_contact(scene, world, rods, rod_step, impulse)
    return _Answer(moved, None, np.zeros(r.size), None, np.einsum("nji,nj->ni", system.frames, r))


def _with_contact(
    scene: Scene,
    solver: GaussSeidel,
    world: World,
    rods: RodModel,
    rod_step: RodStep,
    contacts: Contacts,
    obstacles: list[Obstacle],
    watch: Watch,
) -> _Answer:
    """Solve the problems of a step; contacts stay where they are at its beginning."""
    system = _contact_system(scene, rods, rod_step, contacts, obstacles)
    guess = _guess(world, contacts, system.frames)
    watch.lap("assembly")
    for iteration in range(1, rods.iterations + 1):
        _check_finite(scene, world, rod_step)
        watch.lap("rods")
        problem = _problem(scene, rod_step.system, contacts, system)
        condensed = problem.condense()
        watch.lap("condensation")
        run = solver.solve(condensed, guess)
        watch.lap("solve")
        v, impulse = problem.velocities(run.r), system.H.T @ run.r
        shape = rod_step.system.f.shape
        rod_step = rod_step.moved(v.reshape(shape), impulse.reshape(shape))
        if rod_step.converged or iteration == rods.iterations:
            break
        guess = run.r
    impulses = np.einsum("nji,nj->ni", system.frames, run.r.reshape(-1, 3))
    return _Answer(rod_step, problem, guess, run, impulses)


def _check_finite(scene: Scene, world: World, rod_step: RodStep) -> None:
    system = rod_step.system
    if not (np.isfinite(system.M).all() and np.isfinite(system.f).all()):
        raise SimulationError(f"{scene.name}: the motion blew up at {world.time:g} s; take a smaller dt")


def _problem(
    scene: Scene, system: System, contacts: Contacts, contact_system: ContactSystem
) -> StepProblem | ConstrainedStep:
    mu = _friction(scene, contacts)
    step = StepProblem(system.matrix(), system.f.ravel(), contact_system.H, contact_system.w, mu)
    constraints = system.constraints()
    return step if constraints is None else ConstrainedStep(step, *constraints)


def _friction(scene: Scene, contacts: Contacts) -> Array:
    return np.where(contacts.obstacle < 0, scene.mu_fibres, scene.mu_obstacles).astype(float)


def _contact_system(
    scene: Scene,
    rods: RodModel,
    rod_step: RodStep,
    contacts: Contacts,
    obstacles: list[Obstacle],
    beta: float = 0.2,
) -> ContactSystem:
    """The Jacobians of both sides of every contact, assembled; side B of an obstacle is not read.

    Overlaps are undone at the rate `beta`, as `assemble` says; with zero, `H v + w` is their velocity.
    """
    both = np.concatenate([contacts.fibre_a, np.maximum(contacts.fibre_b, 0)])
    jacobian, drift = rod_step.contact_points(both, np.concatenate([contacts.s_a, contacts.s_b]))
    (jacobian_a, jacobian_b), (drift_a, drift_b) = (np.split(x, 2) for x in (jacobian, drift))
    of_obstacles = obstacle_drift(contacts, obstacles)
    drift_b = np.where(contacts.obstacle[:, None] < 0, drift_b, of_obstacles)
    system = assemble(
        contacts, jacobian_a, jacobian_b, drift_a, drift_b,
        dt=scene.dt, rods=len(scene.rods.length), beta=beta,
    )  # fmt: skip
    if rods.local_support:
        system.H.eliminate_zeros()
    return system


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
