"""Explicit penalty contact: its law, the balance of forces, and the faults that the talk finds with it."""

import math
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from fibercontact.cli import app
from fibercontact.contact.obstacles import Plane
from fibercontact.errors import UserError
from fibercontact.rods import circular_rods, discretise, inertia_matrix, rest_state
from fibercontact.rods.discrete_model import discrete_state, split
from fibercontact.simulation.penalty import Penalty, penalty_for
from fibercontact.simulation.scene import Body, Motion, Scene
from fibercontact.simulation.scenes import Parameters, build
from fibercontact.simulation.step import SimulationError, simulate

GRAVITY, RADIUS, LENGTH, DENSITY = 9.81, 1e-3, 0.1, 1000.0
MASS = DENSITY * np.pi * RADIUS**2 * LENGTH
SEGMENTS = 6
MODELS = ("helix", "discrete")
numbers = st.floats(-1.0, 1.0)


def scene_of(rods, state, obstacles=(), dt=1e-4, steps=100, mu=0.5, gravity=GRAVITY, motion=None):
    body = Body(np.zeros(3), motion, obstacles) if motion else Body(np.zeros(3), obstacles=obstacles)
    return Scene(
        name="test", description="", rods=rods, state=state, bodies=[body],
        carrier=np.zeros(len(rods.length), dtype=np.int64), dt=dt, steps=steps, mu_fibres=mu, mu_obstacles=mu,
        gravity=lambda time: np.array([0, 0, -gravity]), segments=SEGMENTS,
    )  # fmt: skip


def make(count=1, young=1e8, model="helix"):
    rods = circular_rods(
        length=[LENGTH] * count,
        radius=RADIUS,
        young=young,
        poisson=0.3,
        density=DENSITY,
        elements=3,
        free=True,
    )
    return rods if model == "helix" else discretise(rods, SEGMENTS)


def placed(rods, position, frame):
    return (discrete_state if hasattr(rods, "edges") else rest_state)(rods, position, frame)


def on_slope(theta, height, **options):
    """A free rod along the slope of a plane inclined by theta; `height` of its centreline above it."""
    turn = Rotation.from_rotvec([0.0, theta, 0.0]).as_matrix()
    rods = make()
    state = rest_state(rods, turn @ [0.0, 0.0, height], turn)
    return scene_of(rods, state, [Plane(np.zeros(3), turn @ [0.0, 0.0, 1.0])], **options)


# The law


@given(
    gap=numbers,
    u=st.tuples(numbers, numbers, numbers),
    mu=st.floats(0, 2),
    damping=st.floats(0, 5),
    slow=st.floats(0, 1),
)
def test_the_force_is_that_of_a_spring_a_dashpot_and_sliding_friction(gap, u, mu, damping, slow):
    force = Penalty(3.0, damping, slow).forces(np.array([gap]), np.array([u]), np.array([mu]))[0]
    if gap >= 0:
        assert not force.any()
        return
    assert force[0] == pytest.approx(max(0.0, -3.0 * gap - damping * u[0]))  # never pulls
    tangential, speed = np.array(u[1:]), math.hypot(*u[1:])
    assert np.linalg.norm(force[1:]) == pytest.approx(
        mu * force[0] * (speed / max(speed, slow) if speed else 0.0), abs=1e-12
    )
    assert force[1:] @ tangential <= 0
    assert force[1] * u[2] == pytest.approx(force[2] * u[1], abs=1e-12)


def test_at_rest_there_is_no_friction():
    force = Penalty(1.0).forces(np.array([-1.0]), np.zeros((1, 3)), np.ones(1))
    np.testing.assert_array_equal(force, [[1.0, 0.0, 0.0]])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0.0,), "penalty stiffness must be positive and finite, not 0"),
        ((math.nan,), "penalty stiffness"),
        ((math.inf,), "penalty stiffness"),
        ((1.0, -1.0), "penalty damping must be finite and not negative, not -1"),
        ((1.0, 0.0, math.nan), "penalty slip_speed must be"),
    ],
)
def test_bad_numbers_are_refused(arguments, message):
    with pytest.raises(UserError, match=message):
        Penalty(*arguments)


# Balances


@pytest.mark.parametrize("model", MODELS)
def test_two_rods_push_each_other_with_opposite_momenta(model):
    """Two rods that cross and overlap, a third of the way along them, without gravity."""
    rods = make(2, model=model)
    frames = np.stack([np.eye(3), Rotation.from_rotvec([0, 0, 1.2]).as_matrix()])
    positions = [[-LENGTH / 3, 0, 0], frames[1] @ [-LENGTH / 4, 0, 0] + [0, 0, 1.5 * RADIUS]]
    state = placed(rods, positions, frames)
    before = state._replace(v=np.zeros_like(state.v))
    step = next(simulate(scene_of(rods, before, gravity=0.0), penalty=Penalty(100.0)))
    v = step.world.state.v
    if model == "helix":
        momenta = np.einsum("rij,rj->ri", inertia_matrix(rods, before), v)[:, :3]
    else:
        momenta = np.sum(split(rods.inertia * v)[0], axis=1)
    impulse = 1e-4 * 100.0 * 0.5 * RADIUS  # dt k overlap
    np.testing.assert_allclose(momenta[1], [0, 0, impulse], rtol=0, atol=1e-9 * impulse)
    np.testing.assert_allclose(momenta[0], -momenta[1], rtol=0, atol=1e-9 * impulse)
    np.testing.assert_allclose(
        step.world.impulses[step.contacts.gap < 0], [[0, 0, -impulse]], atol=1e-12 * impulse
    )


def test_a_stiff_level_rod_falls_on_springs_as_a_particle_does():
    """Seven equal contacts on a rod that does not bend: a mass on seven springs and dashpots."""
    k, nu, dt, steps = 50.0, 0.02, 1e-4, 400
    rods = make(young=1e13)
    state = rest_state(rods, [0.0, 0.0, RADIUS + 1e-4])
    plane = Plane(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    scene = scene_of(rods, state, [plane], dt=dt, steps=steps)
    z, v = 1e-4, 0.0
    for step in simulate(scene, penalty=Penalty(k, nu)):
        force = (SEGMENTS + 1) * max(0.0, -k * z - nu * v) if z < 0 else 0.0
        v += dt * (force / MASS - GRAVITY)
        z += dt * v
        assert step.world.state.root_position[0, 2] == pytest.approx(RADIUS + z, abs=5e-9)
        assert step.world.impulses[:, 2].sum() == pytest.approx(dt * force, abs=1e-3 * dt * MASS * GRAVITY)
        assert step.problem is None
        assert step.run is None
    assert z == pytest.approx(-MASS * GRAVITY / (SEGMENTS + 1) / k, rel=1e-2)  # it has come to rest


def test_a_sliding_belt_drags_the_rod_along():
    """Obstacles' velocities count in u: friction accelerates the rod at mu g until it has the belt's speed."""
    rods = make()
    overlap = MASS * GRAVITY / (SEGMENTS + 1) / 200.0
    state = rest_state(rods, [0.0, 0.0, RADIUS - overlap])
    plane = Plane(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    belt = lambda time: Motion(np.array([1.0, 0.0, 0.0]), np.zeros(3))  # noqa: E731
    scene = scene_of(rods, state, [plane], steps=200, mu=0.3, motion=belt)
    *_, last = simulate(scene, penalty=Penalty(200.0, 0.02))
    np.testing.assert_allclose(last.world.state.v[0, 0], 0.3 * GRAVITY * last.world.time, rtol=0.01)


# What the talk says


def creep(theta, mu, penalty, dt, time):
    """Mean speed down the slope of a rod that begins at rest, its springs in balance."""
    weight = MASS * GRAVITY * math.cos(theta) / (SEGMENTS + 1)
    scene = on_slope(theta, RADIUS - weight / penalty.stiffness, dt=dt, steps=round(time / dt), mu=mu)
    *_, last = simulate(scene, penalty=penalty)
    moved = last.world.state.root_position - scene.state.root_position
    return float(np.linalg.norm(moved)) / time


@pytest.mark.parametrize("dt", [2e-4, 1e-4])
def test_the_plain_law_creeps_below_the_friction_angle(dt):
    """The velocity jumps as a rotation of the circle, `u + dt (g sin − mu g cos sign u)`, of mean `dt g sin`."""
    theta, mu = 0.2, 0.5
    speed = creep(theta, mu, Penalty(200.0, 0.05), dt, time=0.1)
    assert speed == pytest.approx(dt * GRAVITY * math.sin(theta), rel=0.05)


@pytest.mark.parametrize("slip_speed", [2e-3, 8e-3])
def test_the_regularised_law_creeps_at_a_share_of_its_speed(slip_speed):
    theta, mu = 0.2, 0.5
    speed = creep(theta, mu, Penalty(200.0, 0.05, slip_speed), 2e-4, time=0.1)
    assert speed == pytest.approx(slip_speed * math.tan(theta) / mu, rel=0.02)


@pytest.mark.parametrize(("share", "stable"), [(0.98, True), (1.02, False)])
@pytest.mark.parametrize("damping", [0.0, 0.05])
def test_a_stiff_rod_blows_up_beyond_the_step_of_theory(share, stable, damping):
    """`dt² s k + 2 dt s damping < 4 m`: the rod rocks on n springs, s = n (n + 1)/(n − 1) times one on its mass."""
    k, n = 200.0, SEGMENTS + 1
    s = n * (n + 1) / (n - 1)
    limit = (-s * damping + math.sqrt((s * damping) ** 2 + 4 * MASS * s * k)) / (s * k)
    rods, overlap = make(young=1e13), MASS * GRAVITY / (n * k)
    plane = Plane(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    tilt = Rotation.from_rotvec([0.0, 1e-3 * overlap / LENGTH, 0.0]).as_matrix()
    state = rest_state(rods, [0.0, 0.0, RADIUS - overlap], tilt)
    scene = scene_of(rods, state, [plane], dt=share * limit, steps=80)
    heights = [s.world.state.root_position[0, 2] for s in simulate(scene, penalty=Penalty(k, damping))]
    strayed = np.abs(np.array(heights) - RADIUS + overlap) / (1e-3 * overlap)
    assert (strayed.max() < 30) == stable


# Scenes


@pytest.mark.parametrize("name", ["wisp", "plane", "wisp@discrete"])
def test_scenes_run_with_penalty_in_place_of_coulomb(name):
    kind, _, model = name.partition("@")
    scene = build(Parameters(kind, 8, "straight", 0.3, 0.3, 1, model or "helix"))
    scene = replace(scene, dt=2e-4, steps=1000)
    penalty = penalty_for(scene)
    touched = 0
    for step in islice(simulate(scene, penalty=penalty), 300):
        assert np.isfinite(step.world.state.v).all()
        assert np.abs(step.contacts.gap.min(initial=0.0)) < scene.rods.radius[0]
        normal = np.einsum("ni,ni->n", step.world.impulses, step.contacts.normal)
        assert (normal >= -1e-15).all()
        touched += int((normal > 0).sum())
    assert touched > 10


def test_the_same_scene_gives_the_same_steps():
    scene = replace(build(Parameters("wisp", 6, "wavy", 0.3, 0.3, 1)), dt=2e-4, steps=30)
    runs = [[step.world.state.q for step in simulate(scene, penalty=penalty_for(scene))] for _ in range(2)]
    np.testing.assert_array_equal(*runs)


def test_too_large_a_step_ends_in_an_error_that_says_so():
    scene = on_slope(0.0, 0.9 * RADIUS, dt=1.0, steps=200)
    with pytest.raises(SimulationError, match="blew up"), np.errstate(all="ignore"):
        list(simulate(scene, penalty=Penalty(1e200)))


def test_the_rule_of_thumb_is_one_percent_of_a_radius_under_the_weight():
    scene = on_slope(0.0, RADIUS)
    penalty = penalty_for(scene)
    assert MASS * GRAVITY / penalty.stiffness == pytest.approx(0.01 * RADIUS)
    assert penalty_for(scene, 7.0) == Penalty(7.0, 0.2 * math.sqrt(7.0 * MASS))


def test_the_command_takes_a_stiffness(tmp_path):
    call = CliRunner().invoke
    done = call(app, ["simulate", "wisp-straight-19-mu0.3", "--steps", "3", "--penalty", "150"])
    assert done.exit_code == 0
    assert "sweeps median 0" in done.output
    assert call(app, ["simulate", "wisp-straight-19-mu0.3", "--penalty", "0"]).exit_code == 2
