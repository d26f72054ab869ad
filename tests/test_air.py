"""Drag against closed formulas, a boundary-value problem, finite differences and thermodynamics, for all rods."""

from collections import deque
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, solve_bvp
from scipy.spatial.transform import Rotation

from fibercontact.rods import (
    CLOTHOID,
    HELIX,
    Drag,
    RootMotion,
    circular_rods,
    rest_state,
    slender_drag,
    still,
)
from fibercontact.rods.discrete_model import discrete_state, discretise, displaced
from fibercontact.rods.dynamics import advance
from fibercontact.rods.interface import rod_model
from fibercontact.rods.kinematics import centreline
from fibercontact.simulation.scene import Air, Body, Scene
from fibercontact.simulation.step import simulate

LENGTH, RADIUS, YOUNG, DENSITY = 0.4, 2e-3, 1e8, 1200.0
BENDING = YOUNG * np.pi * RADIUS**4 / 4
LINE_DENSITY = DENSITY * np.pi * RADIUS**2
DOWN, NOWHERE = np.array([0, 0, -9.81]), np.zeros(3)
MODELS = ("helix", "clothoid", "springs", "rigid")
every_model = pytest.mark.parametrize("model", MODELS)


def make(model, elements=3, curvature=(0.0, 0.0, 0.0), free=True, young=YOUNG):
    """A rod in its natural shape, with three edges an element when it is discrete."""
    basis = CLOTHOID if model == "clothoid" else HELIX
    rods = circular_rods(
        length=LENGTH, radius=RADIUS, young=young, poisson=0.4, density=DENSITY,
        elements=elements, curvature=curvature, free=free, basis=basis,
    )  # fmt: skip
    if model in ("helix", "clothoid"):
        return rods, rest_state(rods)
    rods = discretise(rods, 3 * elements, inextensible=model == "rigid")
    return rods, discrete_state(rods)


def turned(rods, state, frame):
    """The same rod with another root frame, unstrained."""
    if hasattr(state, "root_frame"):
        return state._replace(root_frame=frame[None])
    return discrete_state(rods, root_frame=frame)


def with_velocity(state, velocity):
    """All points of a free rod move at a velocity."""
    v = state.v.copy()
    if hasattr(state, "root_frame"):
        v[:, :3] = velocity
    else:
        for c in range(3):
            v[:, c::4] = velocity[c]
    return state._replace(v=v)


def root_velocity(state):
    return state.v[0, :3]


def run(rods, state, steps, dt, drag=None, gravity=NOWHERE, root=None):
    """States of steps without contact; the wind of `drag` may be a function of time."""
    model = rod_model(rods)
    for _ in range(steps):
        step = model.begin(state, root or still(1), gravity, dt, drag)
        for _ in range(30):
            v = step.system.free_velocities()
            step = step.moved(v, np.zeros_like(v))
            if step.converged:
                break
        state = step.end()
        yield state


def last(states):
    return deque(states, maxlen=1).pop()


# Coefficients


@pytest.mark.parametrize(("slenderness", "tolerance"), [(100, 2e-2), (10000, 2e-4)])
def test_a_cylinder_drags_as_a_line_of_stokeslets_does(slenderness, tolerance):
    """A uniform line force moves its surface, in the mean, at the speed that the coefficients say."""
    L, viscosity = 1.0, 0.3
    a = L / slenderness

    def mobility(kernel):
        pairs = lambda x: 2 * (L - x) * kernel(x, np.hypot(x, a)) / L  # noqa: E731
        return quad(pairs, 0, L, points=[a, 10 * a], epsabs=1e-12)[0] / (8 * np.pi * viscosity)

    across = mobility(lambda x, R: 1 / R + a**2 / (2 * R**3))  # mean over the section
    along = mobility(lambda x, R: 1 / R + x**2 / R**3)
    normal, tangential = slender_drag(L, a, viscosity)
    assert normal * across == pytest.approx(1, abs=tolerance)
    assert tangential * along == pytest.approx(1, abs=tolerance)


@pytest.mark.parametrize(
    "arguments",
    [(1.0, 0.2, 1.0), (1.0, 0.0, 1.0), (1.0, 0.01, -1.0), (np.nan, 0.01, 1.0), (1.0, 0.01, np.inf)],
)
def test_what_is_not_slender_has_no_formula(arguments):
    with pytest.raises(ValueError, match="length ≥ 10 radius > 0"):
        slender_drag(*arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((-1.0, 0.0), "normal drag must be finite and not negative, not -1"),
        ((1.0, np.nan), "tangential drag must be finite and not negative, not nan"),
        ((np.inf, 1.0), "normal drag"),
        ((1.0, 1.0, [1.0, 2.0]), r"wind must be a finite vector \(3,\), not"),
        ((1.0, 1.0, [1.0, 2.0, np.inf]), "wind must be"),
    ],
)
def test_bad_drag_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Drag(*arguments)
    with pytest.raises(ValueError, match=message):
        Air(*arguments[:2], *(lambda time, w=w: w for w in arguments[2:]))


# Falling


@every_model
@pytest.mark.parametrize("tilt", [0.0, 0.5, np.pi / 2], ids=["broadside", "slanted", "lengthwise"])
def test_a_falling_rod_reaches_its_terminal_velocity(model, tilt):
    """Both components of the velocity are those of implicit Euler, `v' = (v + dt g) / (1 + dt C/(rho S))`."""
    frame = Rotation.from_rotvec([0, tilt, 0]).as_matrix()
    rods, state = make(model)
    dt, drag, t = 0.08, Drag(0.05, 0.02), frame[:, 0]
    along, across = (DOWN @ t) * t, DOWN - (DOWN @ t) * t

    def after(steps):
        parts = ((across, drag.normal), (along, drag.tangential))
        rates = [(LINE_DENSITY / C * g, 1 + dt * C / LINE_DENSITY) for g, C in parts]
        return sum(terminal * (1 - factor**-steps) for terminal, factor in rates)

    states = list(run(rods, turned(rods, state, frame), 100, dt, drag, DOWN))
    for steps in (1, 10, 100):
        np.testing.assert_allclose(root_velocity(states[steps - 1]), after(steps), rtol=0, atol=1e-8)
    terminal = LINE_DENSITY * (across / drag.normal + along / drag.tangential)
    np.testing.assert_allclose(
        root_velocity(states[-1]), terminal, rtol=0, atol=1e-4 * np.linalg.norm(terminal)
    )


# Invariance


@every_model
def test_only_the_velocity_relative_to_the_wind_counts(model):
    """A free rod in a wind moves as one that meets still air at the opposite velocity."""
    wind = np.array([1.0, -2.0, 0.5])
    rods, state = make(model, curvature=(3.0, 5.0, -4.0))
    dt, steps = 2e-3, 30
    in_wind = last(run(rods, state, steps, dt, Drag(0.05, 0.02, wind)))
    in_still_air = last(run(rods, with_velocity(state, -wind), steps, dt, Drag(0.05, 0.02)))
    np.testing.assert_allclose(in_wind.v, with_velocity(state, wind).v + in_still_air.v, rtol=0, atol=1e-8)
    assert np.linalg.norm(root_velocity(in_wind)) > 0.1


@every_model
def test_a_root_moved_through_still_air_feels_a_wind(model):
    wind = np.array([1.0, -2.0, 0.5])
    rods, state = make(model, curvature=(3.0, 5.0, -4.0), free=False)
    dt, steps, moved = 2e-3, 30, still(1)._replace(velocity=-wind[None])
    held = last(run(rods, state, steps, dt, Drag(0.05, 0.02, wind)))
    start = state if hasattr(state, "root_frame") else with_velocity(state, -wind)
    carried = last(run(rods, start, steps, dt, Drag(0.05, 0.02), root=moved))
    shapes = [rod_model(rods).centreline(s, 12) - s.root_position[:, None] for s in (held, carried)]
    np.testing.assert_allclose(shapes[0], shapes[1], rtol=0, atol=1e-8)
    straying = shapes[0] - rod_model(rods).centreline(state, 12)
    assert np.abs(straying).max() > 1e-3


# Work


def tumbling(model, seed, free):
    """A soft rod in a random shape and motion, and a random motion of its root."""
    rng = np.random.default_rng(seed)
    rods, state = make(model, curvature=rng.normal(size=3) * 8, free=free, young=1e3)
    state = turned(rods, state, Rotation.random(random_state=rng).as_matrix())
    root = RootMotion(*rng.normal(size=(2, 1, 3)), *np.zeros((2, 1, 3)))
    return rods, state._replace(v=rng.normal(size=state.v.shape)), root


def drag_terms(rods, state, root, drag, dt):
    """What drag adds to M and to f, and the first of the prescribed velocities that the step has."""
    model = rod_model(rods)
    with_drag, without = (model.begin(state, root, NOWHERE, dt, d).system for d in (drag, None))
    return (with_drag.matrix() - without.matrix()).toarray(), (with_drag.f - without.f)[0]


coefficients = st.floats(0.0, 1e3)


@every_model
@settings(max_examples=40)
@given(normal=coefficients, tangential=coefficients, seed=st.integers(0, 5), free=st.booleans())
def test_drag_never_adds_energy_in_still_air(model, normal, tangential, seed, free):
    """Its impulse is −(matrix) v with a symmetric matrix that is not negative, whatever the step."""
    rods, state, _ = tumbling(model, seed, free)
    if not free:
        state = state._replace(v=0 * state.v)
    matrix, constant = drag_terms(rods, state, still(1), Drag(normal, tangential), 1e-3)
    size = max(normal, tangential) * 1e-3 * LENGTH
    np.testing.assert_array_equal(matrix, matrix.T)
    assert np.linalg.eigvalsh(matrix).min() >= -1e-12 * max(size, 1e-3)
    np.testing.assert_allclose(constant, 0, atol=1e-12 * max(size, 1e-3))


INTERVALS = 600


def moved(rods, state, v, root, t):
    """Points (m, 3) of the centreline after a time t at the velocity v."""
    if hasattr(state, "root_frame"):
        return centreline(rods, advance(rods, state, v, root, t), INTERVALS)[0]
    return displaced(state, t * v).position[0]


def rate(rods, state, v, root=None, h=1e-6):
    """Velocities of the points, by differences."""
    return (moved(rods, state, v, root, h) - moved(rods, state, v, root, -h)) / (2 * h)


def lengths(rods, state):
    """Pieces of a rod: the point each moves with, its tangent and its length (Simpson's rule, or half edges)."""
    points = moved(rods, state, state.v, None, 0.0)
    if hasattr(state, "root_frame"):
        weight = LENGTH / INTERVALS / 3 * np.array([1, *([4, 2] * (INTERVALS // 2))])
        weight[-1] /= 2
        tangent = np.gradient(points, axis=0, edge_order=2)
        return np.arange(INTERVALS + 1), tangent / np.linalg.norm(tangent, axis=1)[:, None], weight
    edges, N = np.diff(points, axis=0), rods.edges
    tangent = edges / np.linalg.norm(edges, axis=1)[:, None]
    return np.r_[:N, 1 : N + 1], np.vstack([tangent, tangent]), np.full(2 * N, LENGTH / N / 2)


@every_model
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("free", [False, True])
def test_the_generalised_force_does_the_work_of_the_force_per_length(model, seed, free):
    """Positions, velocities and tangents are differences of the centreline."""
    rods, state, root = tumbling(model, seed, free)
    drag, dt = Drag(0.7, 0.2, np.array([0.4, -0.3, 1.0])), 1e-3
    matrix, constant = drag_terms(rods, state, root, drag, dt)
    prescribed = state.v.shape[1] - len(constant)
    if prescribed:
        state = state._replace(v=rod_model(rods).begin(state, root, NOWHERE, dt).now.v)
    point, t, length = lengths(rods, state)
    slip = rate(rods, state, state.v, root)[point] - drag.wind
    along = np.sum(t * slip, axis=1, keepdims=True) * t
    force = -length[:, None] * (drag.normal * (slip - along) + drag.tangential * along)
    impulse = -(matrix @ state.v[0, prescribed:] + constant)
    for dof, direction in enumerate(np.eye(state.v.shape[1])[prescribed:, None]):
        work = np.sum(force * rate(rods, state, direction)[point])
        assert impulse[dof] == pytest.approx(dt * work, rel=1e-4, abs=1e-5 * dt * np.abs(force).sum())


@every_model
@pytest.mark.parametrize("dt", [1e-3, 1e1])
def test_no_drag_is_too_strong_for_a_step(model, dt):
    """Air like honey stops a free rod at once, whatever the step."""
    rods, state = make(model, curvature=(3.0, 5.0, -4.0))
    state = with_velocity(state, np.array([3.0, 1.0, -2.0]))
    ends = [np.abs(s.v).max() for s in run(rods, state, 3, dt, Drag(1e6, 1e6))]
    assert max(ends) < 1e-4


# Equilibria


def settled(rods, state, drag=None, gravity=NOWHERE):
    """Equilibrium under drag and gravity; strong implicit damping by long steps finds it."""
    for now in run(rods, state, 100, 0.2, drag, gravity):
        if np.abs(now.v).max() < 1e-13:
            break
    assert np.abs(now.v).max() < 1e-8
    return now


def tip(rods, state):
    return (
        rod_model(rods).centreline(state, 1)[0, -1] if hasattr(state, "root_frame") else state.position[0, -1]
    )


@every_model
def test_a_weak_wind_bends_a_rod_as_a_weak_gravity_of_the_same_load(model):
    rods, state = make(model, elements=6, free=False)
    load = 1e-4 * BENDING / LENGTH**3
    wind = Drag(0.05, 0.02, np.array([0, 0, -load / 0.05]))
    ends = [
        tip(rods, settled(rods, state, **given))
        for given in ({"drag": wind}, {"gravity": np.array([0, 0, -load / LINE_DENSITY])})
    ]
    assert ends[0][2] == pytest.approx(ends[1][2], rel=1e-7)
    assert ends[0][2] == pytest.approx(-load * LENGTH**4 / (8 * BENDING), rel=0.015)


def wind_tip(drag):
    """End of a rod clamped along x in a wind in the plane xz, by `EI theta'' = sin theta N_x + cos theta N_z`."""

    def rates(s, y):
        c, d = np.cos(y[0]), np.sin(y[0])
        t = np.array([c, -d])
        along = drag.wind[[0, 2]] @ t
        force = drag.normal * (drag.wind[[0, 2], None] - along * t) + drag.tangential * along * t
        return np.array([y[1], (d * y[2] + c * y[3]) / BENDING, *-force, c, -d])

    def ends(root, free):
        return np.array([root[0], free[1], free[2], free[3], root[4], root[5]])

    s = np.linspace(0, LENGTH, 41)
    guess = np.zeros((6, 41))
    guess[4] = s
    solution = solve_bvp(rates, ends, s, guess, tol=1e-8)
    assert solution.success
    return np.array([solution.y[4, -1], 0.0, solution.y[5, -1]])


@pytest.mark.parametrize("direction", [(-0.5, 0.0, -1.0), (1.0, 0.0, -1.0)])
@every_model
def test_a_rod_in_a_strong_wind_has_the_shape_of_the_boundary_value_problem(model, direction):
    strength = 8 * BENDING / LENGTH**3 / 0.05
    drag = Drag(0.05, 0.02, strength * np.array(direction))
    expected = wind_tip(drag)
    assert expected[2] < -0.3 * LENGTH
    order, allowed = (4, 2e-4) if model == "clothoid" else (2, 1e-2)
    errors = []
    for elements in (4, 8):
        rods, state = make(model, elements, free=False)
        errors.append(np.linalg.norm(tip(rods, settled(rods, state, drag)) - expected) / LENGTH)
    assert errors[1] < allowed
    assert errors[0] / errors[1] > 0.7 * 2**order


# Scenes


def test_the_wind_of_a_scene_is_that_at_the_end_of_the_step():
    rods, state = make("helix")
    direction, C, dt = np.array([0.0, 1.0, 0.0]), 0.05, 0.1
    scene = Scene(
        name="breeze", description="", rods=rods, state=state, bodies=[Body(NOWHERE)],
        carrier=np.zeros(1, dtype=np.int64), dt=dt, steps=3, mu_fibres=0.0, mu_obstacles=0.0,
        gravity=lambda time: NOWHERE, air=Air(C, 0.0, lambda time: time * direction),
    )  # fmt: skip
    v, factor = 0.0, dt * C / LINE_DENSITY
    for k, step in enumerate(simulate(scene), start=1):
        v = (v + factor * k * dt) / (1 + factor)
        np.testing.assert_allclose(root_velocity(step.world.state), v * direction, rtol=0, atol=1e-12)
    *_, calm = simulate(replace(scene, air=Air(C, 0.0)))
    np.testing.assert_array_equal(calm.world.state.v, 0)
