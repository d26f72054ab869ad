"""Rods against textbook solutions, boundary-value problems and conservation laws."""

from collections import deque

import numpy as np
import oracles
import pytest
from scipy.integrate import solve_bvp, solve_ivp
from scipy.linalg import eigh
from scipy.optimize import root as find_root
from scipy.spatial.transform import Rotation

from fibercontact.rods import (
    CLOTHOID,
    HELIX,
    RootMotion,
    advance,
    circular_rods,
    energy,
    generalised_force,
    inertia_matrix,
    point_jacobian,
    rest_state,
    step_system,
    stiffness_matrix,
    still,
)
from fibercontact.rods.motion import POINTS, sample
from fibercontact.rods.quadrature import gauss

LENGTH, RADIUS, YOUNG, DENSITY, POISSON = 0.4, 2e-3, 1e8, 1200.0, 0.4
BENDING = YOUNG * np.pi * RADIUS**4 / 4
LINE_DENSITY = DENSITY * np.pi * RADIUS**2
DOWN, NOWHERE = np.array([0, 0, -9.81]), np.zeros(3)
CANTILEVER_ROOTS = [1.875104068712, 4.694091132974, 7.854757438238]  # cos x cosh x = -1
ORDER = {HELIX: 2, CLOTHOID: 4}  # of equilibria and frequencies, in the size of the elements
ELEMENTS = {HELIX: (4, 8, 16), CLOTHOID: (3, 6, 12)}
both_bases = pytest.mark.parametrize("basis", [HELIX, CLOTHOID], ids=["helix", "clothoid"])


def make(elements, basis, **options):
    material = {"length": LENGTH, "radius": RADIUS, "young": YOUNG, "poisson": POISSON, "density": DENSITY}
    rods = circular_rods(**material | {"elements": elements, "basis": basis} | options)
    return rods, rest_state(rods)


def run(rods, state, steps, dt, gravity=NOWHERE, motion=None):
    """Take steps without contact; `motion(t)` gives what is prescribed to the roots."""
    for k in range(steps):
        root = motion((k + 1) * dt) if motion else None
        M, f = step_system(rods, state, root, gravity, dt)
        state = advance(rods, state, np.linalg.solve(M, -f[:, :, None])[:, :, 0], root, dt)
        yield state


def last(states):
    return deque(states, maxlen=1).pop()


def tip(rods, state):
    return point_jacobian(rods, state, [0], rods.length[:1]).position[0]


def assert_converges(errors, basis):
    """Errors on elements halved twice; the last is small for the order."""
    assert np.all(np.divide(errors[:-1], errors[1:]) > 0.75 * 2 ** ORDER[basis])
    assert errors[-1] < {HELIX: 2e-3, CLOTHOID: 2e-5}[basis]


# Vibration


def bending_frequencies(elements, basis):
    """First three frequencies (rad/s) of the straight rod, bending about n_1."""
    rods, state = make(elements, basis)
    bend = slice(1, None, 3)
    K, inertia = stiffness_matrix(rods)[0, bend, bend], inertia_matrix(rods, state)[0, bend, bend]
    return np.sqrt(eigh(K, inertia, eigvals_only=True)[:3])


@both_bases
def test_cantilever_frequencies_converge_to_those_of_the_beam(basis):
    beam = np.array(CANTILEVER_ROOTS) ** 2 * np.sqrt(BENDING / LINE_DENSITY) / LENGTH**2
    errors = np.array([abs(bending_frequencies(N, basis) / beam - 1) for N in (5, 10, 20)])
    assert errors[1, 0] < 0.01
    assert np.all(errors[2] < 0.01)
    assert np.all(errors[:-1] / errors[1:] > 0.8 * 2 ** ORDER[basis])


@both_bases
def test_a_free_rod_twists_at_the_frequencies_of_the_shaft(basis):
    """`f_k = k/(2 L) sqrt(G/rho)`: the only inertia against twist is that of the sections."""
    shear = YOUNG / (2 * (1 + POISSON))
    shaft = np.pi * np.arange(1, 3) / LENGTH * np.sqrt(shear / DENSITY)
    errors = []
    for N in (5, 10, 20):
        rods, state = make(N, basis, free=True)
        twist = [3, *range(6, state.v.shape[1], 3)]
        block = np.ix_(twist, twist)
        K, inertia = stiffness_matrix(rods)[0][block], inertia_matrix(rods, state)[0][block]
        frequencies = np.sqrt(np.abs(eigh(K, inertia, eigvals_only=True)[:3]))
        assert frequencies[0] < 1e-5 * frequencies[1]  # the rod turns as a whole
        errors.append(abs(frequencies[1:] / shaft - 1))
    assert np.all(np.divide(errors[:-1], errors[1:]) > 0.8 * 2 ** ORDER[basis])


@both_bases
def test_a_released_rod_swings_and_decays_as_its_first_mode_does(basis):
    """The step is implicit Euler: of a mode of frequency w it makes one with damping (nu + dt) w²/2."""
    damping = 2e-3
    rods, state = make(4, basis, damping=damping)
    bend = slice(1, None, 3)
    K, inertia = stiffness_matrix(rods)[0, bend, bend], inertia_matrix(rods, state)[0, bend, bend]
    squares, modes = eigh(K, inertia)
    w, mode = np.sqrt(squares[0]), modes[:, 0] / np.linalg.norm(modes[:, 0])
    state.q[0, :, 1] = 1e-3 * mode
    dt, steps = 2 * np.pi / w / 400, 1000
    path = 1e3 * np.array([state.q[0, :, 1] @ mode for state in run(rods, state, steps, dt)])
    t, decay = dt * np.arange(1, steps + 1), (damping + dt) * squares[0] / 2
    swing = np.sqrt(squares[0] - decay**2)
    expected = np.exp(-decay * t) * (np.cos(swing * t) + decay / swing * np.sin(swing * t))
    np.testing.assert_allclose(path, expected, rtol=0, atol=0.02)
    assert abs(w / (CANTILEVER_ROOTS[0] ** 2 * np.sqrt(BENDING / LINE_DENSITY) / LENGTH**2) - 1) < 0.02


# Equilibria


def equilibrium(rods, state, gravity, motion=None, stages=8):
    """Curvatures that balance a load which grows in stages."""
    scale = stiffness_matrix(rods)[0].diagonal()

    def force(q, load):
        return generalised_force(rods, state._replace(q=q.reshape(state.q.shape)), *load)[0] / scale

    q = state.q.ravel()
    for share in np.linspace(0, 1, stages + 1)[1:]:
        powers = (0.5, 0.5, 1, 1)  # accelerations go like squared velocities
        scaled = motion and RootMotion(*(share**p * x for p, x in zip(powers, motion, strict=True)))
        solution = find_root(force, q, args=((share * gravity, scaled),), tol=1e-12)
        q = solution.x
    assert np.abs(solution.fun).max() < 1e-7 * np.abs(q).max()
    return state._replace(q=q.reshape(state.q.shape))


@both_bases
@pytest.mark.parametrize("weight", [0.1, 3.0, 20.0])
def test_heavy_cantilever_sags_as_the_elastica(weight, basis):
    gravity = DOWN / 9.81 * weight * BENDING / (LINE_DENSITY * LENGTH**3)
    expected = oracles.elastica_tip(weight)
    errors = [
        np.linalg.norm(tip(rods, equilibrium(rods, state, gravity)) / LENGTH - expected)
        for rods, state in (make(N, basis) for N in ELEMENTS[basis])
    ]
    assert_converges(errors, basis)


def naturally_curved_tip(rest, stiffness, gravity):
    """Tip of a heavy Kirchhoff rod of constant natural curvature, by shooting for the moment at its root."""

    def rates(s, y, g):
        F, kappa = y[3:12].reshape(3, 3), y[12:]
        turn = np.array([[0, -kappa[2], kappa[1]], [kappa[2], 0, -kappa[0]], [-kappa[1], kappa[0], 0]])
        force = F.T @ (LINE_DENSITY * (LENGTH - s) * g)
        t_x_force = np.array([0, -force[2], force[1]])
        moment_rate = -turn @ (stiffness * (kappa - rest)) - t_x_force
        return np.concatenate([F[:, 0], (F @ turn).ravel(), moment_rate / stiffness])

    def shoot(kappa, g):
        y = np.concatenate([np.zeros(3), np.eye(3).ravel(), kappa])
        return solve_ivp(rates, (0, LENGTH), y, args=(g,), rtol=1e-8, atol=1e-10).y[:, -1]

    kappa = rest
    for share in (0.3, 1.0):
        kappa = find_root(lambda k, g=share * gravity: shoot(k, g)[12:] - rest, kappa, tol=1e-8).x
    end = shoot(kappa, gravity)
    np.testing.assert_allclose(end[12:], rest, rtol=0, atol=1e-5)
    return end[:3]


@both_bases
def test_naturally_curved_rod_bends_and_twists_as_the_boundary_value_problem(basis):
    rest, gravity = np.array([3.0, 6.0, -2.0]), 0.6 * DOWN
    rods, _ = make(4, basis)
    expected = naturally_curved_tip(rest, rods.stiffness[0], gravity)
    errors = [
        np.linalg.norm(tip(rods, equilibrium(rods, state, gravity)) - expected) / LENGTH
        for rods, state in (make(N, basis, curvature=rest) for N in ELEMENTS[basis])
    ]
    assert_converges(errors, basis)


def centrifugal_tip(hub, spin):
    """Tip of a rod clamped along y on a hub of radius `hub`, steady in the frame that turns about z."""
    load, s = LINE_DENSITY * spin**2, np.linspace(0, LENGTH, 41)

    def rates(_, y):
        cosine, sine = np.cos(y[2]), np.sin(y[2])
        return np.array(
            [cosine, sine, y[3], (sine * y[4] - cosine * y[5]) / BENDING, -load * y[0], -load * y[1]]
        )

    def ends(root, free):
        return np.array([root[0] - hub, root[1], root[2] - np.pi / 2, free[3], free[4], free[5]])

    guess = np.array([0 * s + hub, s, 0 * s + np.pi / 2, 0 * s, 0 * s, 0 * s])
    solution = solve_bvp(rates, ends, s, guess, tol=1e-8)
    assert solution.success
    return np.array([solution.y[0, -1], solution.y[1, -1], 0])


@both_bases
def test_steadily_rotating_rod_feels_the_centrifugal_force(basis):
    hub, spin = 0.2, 6.0
    axis = np.array([0, 0, spin])
    arm = np.array([hub, 0, 0])
    velocity = np.cross(axis, arm)
    motion = RootMotion(*(x[None] for x in (velocity, axis, np.cross(axis, velocity), np.zeros(3))))
    along_y = np.column_stack([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
    expected = centrifugal_tip(hub, spin)
    errors = []
    for N in ELEMENTS[basis]:
        rods, _ = make(N, basis)
        state = rest_state(rods, arm, along_y)
        end = tip(rods, equilibrium(rods, state, NOWHERE, motion))
        errors.append(np.linalg.norm(end - expected) / LENGTH)
    assert np.linalg.norm(expected - [hub, LENGTH, 0]) > 0.1 * LENGTH
    assert_converges(errors, basis)


# Prescribed roots


def swinging(basis, free=False):
    rods, state = make(3, basis, curvature=[1.0, 2.0, -1.0], free=free)
    rng = np.random.default_rng(3)
    frame = Rotation.random(1, random_state=rng).as_matrix()
    return rods, state._replace(root_frame=frame, v=rng.normal(size=state.v.shape))


@both_bases
def test_a_rod_on_a_root_in_uniform_motion_does_not_know(basis):
    rods, state = swinging(basis)
    velocity = np.array([[1.0, -2.0, 3.0]])
    carried = still(1)._replace(velocity=velocity)
    dt, steps = 1e-3, 20
    at_rest = last(run(rods, state, steps, dt, DOWN))
    moving = last(run(rods, state, steps, dt, DOWN, lambda t: carried))
    np.testing.assert_allclose(moving.q, at_rest.q, rtol=0, atol=1e-11)
    shift = moving.root_position - at_rest.root_position
    np.testing.assert_allclose(shift, steps * dt * velocity, rtol=0, atol=1e-13)


@both_bases
def test_an_accelerated_root_acts_as_gravity_does(basis):
    rods, state = swinging(basis)
    a = np.array([3.0, -5.0, 2.0])
    accelerated = still(1)._replace(acceleration=a[None])
    M, f = step_system(rods, state, accelerated, DOWN, 1e-3)
    other_M, other_f = step_system(rods, state, None, DOWN - a, 1e-3)
    np.testing.assert_array_equal(M, other_M)
    np.testing.assert_allclose(f, other_f, rtol=0, atol=1e-13 * abs(f).max())


@both_bases
def test_a_turning_root_carries_a_stiff_rod_along_as_a_rigid_body(basis):
    """A root that starts to turn smoothly; the rod, a thousand times stiffer than its load, follows it."""
    rods, state = make(3, basis, young=1e4 * YOUNG, damping=1e-3)
    rate, dt, steps = 4.0, 2e-3, 200

    def motion(t):
        return still(1)._replace(
            angular_velocity=np.array([[0, 0, rate * t]]), angular_acceleration=np.array([[0, 0, rate]])
        )

    state = last(run(rods, state, steps, dt, NOWHERE, motion))
    angle = rate * dt**2 * steps * (steps + 1) / 2
    rigid = LENGTH * np.array([np.cos(angle), np.sin(angle), 0])
    np.testing.assert_allclose(tip(rods, state), rigid, rtol=0, atol=2e-3 * LENGTH)


# Conservation


def halving_ratios(drifts):
    return np.divide(drifts[:-1], drifts[1:])


@both_bases
def test_energy_drift_of_a_large_swing_is_of_first_order(basis):
    rods, state = make(3, basis)
    before = sum(energy(rods, state, DOWN))[0]
    drifts = []
    for steps in (100, 200, 400):
        end = last(run(rods, state, steps, 0.3 / steps, DOWN))
        drifts.append(abs(sum(energy(rods, end, DOWN))[0] - before))
    assert np.abs(end.q).max() > 5  # rad/m: large indeed
    assert np.all((halving_ratios(drifts) > 1.7) & (halving_ratios(drifts) < 2.3))


@both_bases
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("free", [False, True])
def test_the_equation_of_motion_conserves_energy_and_momenta(free, seed, basis):
    """With the acceleration `𝕄⁻¹ (F − 𝕂 (q − q⁰))` they have no rate; the rod is fat, so that spin counts."""
    rods, state = make(3, basis, radius=0.2, young=10.0, free=free)
    rng = np.random.default_rng(seed)
    frame = Rotation.random(1, random_state=rng).as_matrix()
    q, v = 8 * rng.normal(size=state.q.shape), 3 * rng.normal(size=state.v.shape)
    state = state._replace(root_frame=frame, q=q, v=v)
    gravity = NOWHERE if free else DOWN
    a = np.linalg.solve(inertia_matrix(rods, state)[0], generalised_force(rods, state, gravity)[0])
    h = 1e-4 / max(1, np.linalg.norm(a) / np.linalg.norm(v))

    def invariants(t):
        near = advance(rods, state, v, None, t)._replace(v=v + t * a)
        return np.hstack([sum(energy(rods, near, gravity)), *(momenta(rods, near) if free else ())])

    rates = (invariants(h) - invariants(-h)) / (2 * h)
    assert np.abs(rates).max() < 1e-4 * np.abs(invariants(0)).max()


@both_bases
def test_a_free_rod_falls_as_a_particle(basis):
    rods, state = make(3, basis, curvature=[1.0, 2.0, -1.0], free=True)
    start = np.array([1.0, 2.0, 3.0])
    state.v[0, :3] = start
    dt, steps = 1e-2, 30
    end = last(run(rods, state, steps, dt, DOWN))
    fallen = steps * dt * start + dt**2 * steps * (steps + 1) / 2 * DOWN
    np.testing.assert_allclose(end.root_position[0], fallen, rtol=0, atol=1e-10)
    np.testing.assert_allclose(end.q, state.q, rtol=0, atol=1e-9)
    np.testing.assert_allclose(end.root_frame, state.root_frame, rtol=0, atol=1e-10)


def momenta(rods, state):
    """Linear and angular momentum (about the world's origin) of one rod."""
    samples = sample(rods, state, still(1))
    mass = rods.line_density[0] * LENGTH / 3 * np.tile(gauss(POINTS).weights, 3)
    position = samples.position[0] + state.root_position[0]
    spin = np.sum(samples.tangent[0] * samples.angular_velocity[0], axis=1)
    section = rods.radius[0] ** 2 / 2 * spin[:, None] * samples.tangent[0]
    density = np.cross(position, samples.velocity[0]) + section
    return mass @ samples.velocity[0], mass @ density


@both_bases
def test_momentum_drift_of_a_tumbling_rod_is_of_first_order(basis):
    rods, state = make(3, basis, curvature=[1.0, 4.0, -2.0], free=True)
    state.v[0, :6] = [0.3, -0.2, 0.1, 2.0, 8.0, -6.0]
    before = momenta(rods, state)
    drifts = []
    for steps in (100, 200, 400):
        after = momenta(rods, last(run(rods, state, steps, 0.2 / steps)))
        drifts.append([np.linalg.norm(a - b) for a, b in zip(after, before, strict=True)])
    ratios = halving_ratios(drifts)
    assert np.all((ratios > 1.7) & (ratios < 2.3))
