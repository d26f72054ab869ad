"""Discrete elastic rods against finite differences, textbook solutions, conservation laws and Coulomb's law."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import oracles
import pytest
from scipy.linalg import eigh, solveh_banded
from scipy.spatial.transform import Rotation

from fibercontact.contact.obstacles import Plane
from fibercontact.problem.fclib import read
from fibercontact.problem.measure import measure
from fibercontact.problem.mobility import Mobility
from fibercontact.rods import RootMotion, bands, circular_rods, still
from fibercontact.rods.discrete_assembly import assemble_gradient, assemble_matrix
from fibercontact.rods.discrete_energy import derivatives, elastic_law, frames, law_energy, strains
from fibercontact.rods.discrete_model import (
    discrete_rods,
    discrete_state,
    discretise,
    displaced,
    join,
    material_director,
    split,
    tangents,
)
from fibercontact.rods.discrete_step import (
    begin,
    discrete_energy,
    discrete_points,
    implicit_step,
)
from fibercontact.simulation import corpus
from fibercontact.simulation.scene import Body, Motion, Scene, SceneError
from fibercontact.simulation.scenes import Parameters, build
from fibercontact.simulation.step import simulate

LENGTH, RADIUS, YOUNG, DENSITY, POISSON = 0.4, 2e-3, 1e8, 1200.0, 0.4
BENDING = YOUNG * np.pi * RADIUS**4 / 4
LINE_DENSITY = DENSITY * np.pi * RADIUS**2
GRAVITY = 9.81
DOWN, NOWHERE = np.array([0, 0, -GRAVITY]), np.zeros(3)
CANTILEVER_ROOTS = [1.8751041, 4.6940911, 7.8547574]  # cos x cosh x = -1


def make(edges, **options):
    material = {"length": LENGTH, "radius": RADIUS, "young": YOUNG, "poisson": POISSON, "density": DENSITY}
    rods = discrete_rods(**(material | {"edges": edges} | options))
    return rods, discrete_state(rods)


def tangled(seed, edges=5, size=0.2, **options):
    """Rods of random rest shape, one of them turned, far from it, with velocities."""
    rng = np.random.default_rng(seed)
    curvature = 0.3 * edges * rng.normal(size=(2, edges - 1, 3))
    shape = {"length": [1.0, 1.5], "radius": 0.1, "young": 1e3, "density": 1e3, "curvature": curvature}
    rods, _ = make(edges, **(shape | options))
    state = discrete_state(rods, [[0, 0, 0], [1, 2, 3]], Rotation.random(2, random_state=rng).as_matrix())
    state = displaced(state, size / edges * rng.normal(size=state.v.shape))
    return rods, state._replace(v=rng.normal(size=state.v.shape))


def gradient(law, state):
    at = frames(state)
    return assemble_gradient(derivatives(law, state, at), at.tangent)


def hessian(law, state):
    """Second derivatives (D, D) of the energy of the first rod, from the bands of the step."""
    at = frames(state)
    none = np.zeros_like(state.v)
    lower = assemble_matrix(none, derivatives(law, state, at), at.tangent, 1.0)
    return bands.sparse(lower[:1]).toarray()


def differences(function, state, h=1e-5):
    """Central differences of a function of the state along each dof, last axis."""
    steps = h * np.eye(state.v.shape[1])[:, None]
    ends = [(function(displaced(state, s)), function(displaced(state, -s))) for s in steps]
    return np.stack([(plus - minus) / (2 * h) for plus, minus in ends], axis=-1)


def part(law, which):
    """The law of one strain, or of stretching (3), alone."""
    keep = np.arange(4) == which
    return law._replace(stiffness=law.stiffness * keep[:3], spring=law.spring * keep[3])


# Energies


@pytest.mark.parametrize("which", range(4))
@pytest.mark.parametrize("seed", range(2))
def test_gradients_and_hessians_are_those_of_finite_differences(which, seed):
    rods, state = tangled(seed)
    law = part(elastic_law(rods), which)
    expected = differences(lambda s: law_energy(law, s), state)
    np.testing.assert_allclose(gradient(law, state), expected, rtol=0, atol=1e-7 * abs(expected).max())
    # The directions of parallel transport do not commute: differences of gradients have a skew part.
    slopes = differences(lambda s: gradient(law, s)[0], state)
    K = hessian(law, state)
    np.testing.assert_allclose(K, (slopes + slopes.T) / 2, rtol=0, atol=1e-7 * abs(K).max())


@pytest.mark.parametrize("which", range(4))
def test_rigid_motions_have_no_energy_and_forces_no_resultant(which):
    rods, state = tangled(3)
    law = part(elastic_law(rods), which)
    turn = Rotation.from_rotvec([0.3, 2.0, -1.0]).as_matrix().T
    moved = state._replace(position=state.position @ turn + [1, 2, 3], director=state.director @ turn)
    np.testing.assert_allclose(law_energy(law, moved), law_energy(law, state), rtol=1e-12)
    nodes, twists = split(gradient(law, state))
    scale = abs(nodes).max()
    np.testing.assert_allclose(nodes.sum(axis=1), 0, atol=1e-12 * scale)
    # A rigid rotation turns directors as well: by its component along the edge beyond their transport.
    torque = np.cross(state.position, nodes).sum(axis=1)
    np.testing.assert_allclose(
        torque + (twists[:, :, None] * tangents(state.position)).sum(axis=1), 0, atol=1e-11 * scale
    )


def test_transport_there_and_back_and_whole_turns_are_remembered():
    _, state = tangled(4, edges=4)
    rng = np.random.default_rng(0)
    away = 0.05 * rng.normal(size=state.v.shape)
    back = displaced(displaced(state, away), -away)
    np.testing.assert_allclose(back.director, state.director, atol=1e-13)
    np.testing.assert_allclose(back.reference_twist, state.reference_twist, atol=1e-13)
    turned = state
    for _ in range(10):  # the last edge spins by ten radians
        spin = np.zeros((2, 4))
        spin[:, -1] = 1.0
        turned = displaced(turned, join(np.zeros((2, 5, 3)), spin))
    change = strains(turned, frames(turned)) - strains(state, frames(state))
    np.testing.assert_allclose(change[:, :, 0], [[0, 0, 10.0]] * 2, atol=1e-12)


def test_split_and_join_are_inverse():
    vector = np.arange(2.0 * 15).reshape(2, 15)
    np.testing.assert_array_equal(join(*split(vector)), vector)
    assert split(vector)[1][0, 1] == 7


@pytest.mark.parametrize("free", [False, True])
def test_the_natural_shape_has_the_natural_strains(free):
    curvature = np.random.default_rng(0).normal(scale=8.0, size=(1, 9, 3))
    rods, state = make(10, curvature=curvature, free=free)
    np.testing.assert_allclose(strains(state, frames(state)), curvature * rods.cells[:, :, None], atol=1e-13)
    assert abs(gradient(elastic_law(rods), state)).max() < 1e-14 * rods.stretching[0]


def test_a_natural_helix_converges_to_the_helix():
    """Curvature and torsion of a helix by its coil's radius and rise; the first directors are normal to it."""
    torsion, curvature = 6.0, 9.0
    errors = []
    for N in (20, 40, 80):
        _, state = make(N, curvature=[torsion, 0.0, curvature], free=True)
        turns = np.linspace(0, LENGTH, N + 1) * math.hypot(torsion, curvature)
        radius = curvature / (torsion**2 + curvature**2)
        rise = torsion / (torsion**2 + curvature**2)
        helix = np.column_stack([radius * np.cos(turns), radius * np.sin(turns), rise * turns])
        errors.append(np.sqrt(np.mean(aligned(state.position[0], helix) ** 2)))
    assert errors[-1] < 2e-3 * LENGTH
    assert np.all(np.divide(errors[:-1], errors[1:]) > 3.3)


def aligned(points, others):
    """Distances of points to others after the best rigid motion."""
    P, Q = points - points.mean(axis=0), others - others.mean(axis=0)
    turn, _ = Rotation.align_vectors(Q, P)
    return np.linalg.norm(turn.apply(P) - Q, axis=1)


def test_super_helices_are_discretised_by_the_means_of_their_curvature():
    curvature = np.random.default_rng(0).normal(size=(1, 3, 3))
    like = circular_rods(
        length=LENGTH, radius=RADIUS, young=YOUNG, poisson=POISSON, density=DENSITY, elements=3,
        curvature=curvature,
    )  # fmt: skip
    for free in (False, True):
        rods = discretise(like._replace(free=free), 7)
        ends = np.array([0.0 if not free else 0.5, *np.arange(1.5, 7)]) / 7
        fine = np.linspace(0, 1, 420001)
        of_fine = curvature[0, np.minimum((3 * fine).astype(int), 2)]
        means = [of_fine[(fine >= a) & (fine < b)].mean(axis=0) for a, b in pairwise(ends)]
        np.testing.assert_allclose(rods.rest_curvature[0], means, atol=1e-4)
        made, _ = make(7, free=free)
        np.testing.assert_allclose(rods.stretching, made.stretching)
        np.testing.assert_allclose(rods.inertia, made.inertia)


# The matrix of a step


def true_matrix(rods, step):
    at = frames(step.now)
    lower = assemble_matrix(rods.inertia, derivatives(step.law, step.now, at), at.tangent, step.dt)
    return lower[:, :, rods.prescribed :]


@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize("seed", range(6))
def test_the_matrix_is_definite_and_the_true_one_where_that_is(free, seed):
    rods, state = tangled(seed, size=0.6, damping=0.01, free=free, density=1.0)
    for dt in (1e-3, 1e-1):
        step = begin(rods, state, None, DOWN, dt)
        M, truth = bands.sparse(step.system.M).toarray(), bands.sparse(true_matrix(rods, step)).toarray()
        np.testing.assert_array_equal(M, M.T)
        D = len(M) // 2
        for block in (slice(0, D), slice(D, 2 * D)):
            assert np.linalg.eigvalsh(M[block, block]).min() > 0
            if np.linalg.eigvalsh(truth[block, block]).min() > 1e-9 * np.trace(truth[block, block]):
                np.testing.assert_array_equal(M[block, block], truth[block, block])
            else:
                more = np.linalg.eigvalsh(M[block, block] - truth[block, block])
                assert more.min() > -1e-9 * more.max()


def test_there_are_configurations_whose_true_matrix_is_indefinite():
    rods, state = tangled(0, size=0.6, damping=0.01, density=1.0)
    step = begin(rods, state, None, DOWN, 1e-1)
    assert np.linalg.eigvalsh(bands.sparse(true_matrix(rods, step)).toarray()).min() < 0


def test_a_compressed_straight_rod_is_made_definite():
    rods, state = make(8, free=True)
    pressed = state._replace(position=0.7 * state.position)
    step = begin(rods, pressed, None, NOWHERE, 1e-2)
    assert not bands.cholesky(true_matrix(rods, step))[1].any()
    assert bands.cholesky(step.system.M)[1].all()


@pytest.mark.parametrize("size", [1, 5, 20])
def test_banded_factors_and_solves_are_those_of_scipy(size):
    rng = np.random.default_rng(size)
    lower = np.zeros((2, 11, size))
    for k in range(min(11, size)):
        lower[:, k, : size - k] = rng.normal(size=(2, size - k))
    lower[:, 0] = 30 + abs(lower[:, 0])
    rhs = rng.normal(size=(2, size, 3))
    factor, definite = bands.cholesky(lower)
    assert definite.all()
    found, M = bands.solve(factor, rhs), bands.sparse(lower).toarray()
    for k in range(2):
        np.testing.assert_allclose(found[k], solveh_banded(lower[k, :size], rhs[k], lower=True), atol=1e-12)
    np.testing.assert_allclose(M @ found.reshape(-1, 3), rhs.reshape(-1, 3), atol=1e-11)
    lower[1, 0, size // 2] = -1
    np.testing.assert_array_equal(bands.cholesky(lower)[1], [True, False])


def test_condensation_uses_the_bands():
    entries = []
    for N in (10, 20, 40):
        rods, state = make(N, curvature=[1.0, 5.0, 2.0])
        system = begin(rods, state, None, DOWN, 1e-2).system
        M = system.matrix()
        mobility = Mobility(M)
        entries.append(len(mobility.factor.L))
        x = np.random.default_rng(0).normal(size=system.f.shape[1])
        y = mobility.solve(x)
        assert np.linalg.norm(M @ y - x) <= 1e-13 * np.linalg.norm(M.toarray(), 2) * np.linalg.norm(y)
    D = 4 * 40 - 4
    assert entries[-1] <= 11 * D
    assert entries[2] - entries[1] == 2 * (entries[1] - entries[0])  # linear in N


# Vibration


def stiffness(edges, axis):
    """Stiffness and inertia of the straight clamped rod in the dofs y (1), or the twists (3)."""
    rods, state = make(edges)
    dofs = np.arange(7, 4 * edges + 3)
    keep = dofs[dofs % 4 == axis]
    return hessian(elastic_law(rods), state)[np.ix_(keep, keep)], np.diag(rods.inertia[0, keep])


@pytest.mark.parametrize("kind", ["bending", "twist"])
def test_frequencies_converge_to_those_of_the_beam(kind):
    if kind == "bending":
        expected = np.array(CANTILEVER_ROOTS) ** 2 * np.sqrt(BENDING / LINE_DENSITY) / LENGTH**2
    else:
        torsion, spin = BENDING / (1 + POISSON), LINE_DENSITY * RADIUS**2 / 2
        expected = (np.arange(3) + 0.5) * np.pi / LENGTH * np.sqrt(torsion / spin)
    axis = 1 if kind == "bending" else 3
    found = [np.sqrt(eigh(*stiffness(N, axis), eigvals_only=True)[:3]) for N in (20, 40, 80)]
    errors = np.abs(np.array(found) / expected - 1)
    assert np.all(errors[-1] < 1e-3)
    assert np.log2(errors[1] / errors[2]).min() > 1.5
    assert errors[0, 0] < 5e-3


def test_a_released_rod_swings_and_decays_as_its_first_mode_does():
    """The step is implicit Euler: of a mode of frequency w it makes one with damping (nu + dt) w²/2."""
    damping, N = 2e-3, 6
    rods, state = make(N, damping=damping)
    squares, modes = eigh(*stiffness(N, 1))
    w = np.sqrt(squares[0])
    y = modes[:, 0] / modes[-1, 0]
    displacement = np.zeros_like(state.v)
    displacement[0, 9::4] = 1e-4 * y
    state = displaced(state, displacement)
    dt, steps = 2 * np.pi / w / 200, 300
    path = []
    for _ in range(steps):
        state = implicit_step(rods, state, None, NOWHERE, dt, tolerance=1e-6)
        path.append(1e4 * state.position[0, -1, 1])
    t, decay = dt * np.arange(1, steps + 1), (damping + dt) * squares[0] / 2
    swing = np.sqrt(squares[0] - decay**2)
    expected = np.exp(-decay * t) * (np.cos(swing * t) + decay / swing * np.sin(swing * t))
    np.testing.assert_allclose(path, expected, rtol=0, atol=0.02)


# Equilibria


def settled(rods, state, gravity):
    """Equilibrium under a load that grows in stages: steps so long that inertia does not count."""
    for share in (0.2, 0.5, 1.0):
        state = implicit_step(rods, state, None, share * gravity, 1e3, iterations=200)
        state = state._replace(v=np.zeros_like(state.v))
    return state


@pytest.mark.parametrize("weight", [3.0, 20.0])
@pytest.mark.parametrize("inextensible", [False, True])
def test_heavy_cantilever_sags_as_the_elastica(weight, inextensible):
    gravity = DOWN / GRAVITY * weight * BENDING / (LINE_DENSITY * LENGTH**3)
    expected, errors = LENGTH * oracles.elastica_tip(weight), []
    for N in (8, 16, 32):
        rods, state = make(N, inextensible=inextensible)
        errors.append(np.linalg.norm(settled(rods, state, gravity).position[0, -1] - expected))
    assert errors[-1] < 8e-3 * LENGTH
    assert np.all(np.log2(np.divide(errors[:-1], errors[1:])) > 1.7)


def test_a_natural_helix_keeps_its_shape():
    rods, state = make(12, curvature=[6.0, 5.0, 4.0])
    for _ in range(20):
        moved = implicit_step(rods, state, None, NOWHERE, 1e-2)
        np.testing.assert_allclose(moved.position, state.position, atol=1e-12)
        state = moved


def test_a_hanging_rod_is_stretched_by_its_weight():
    """Springs keep the length up to `rho S g L/ES`; the half node at the end makes the sum exact."""
    turn = Rotation.from_rotvec([0, np.pi / 2, 0]).as_matrix()
    rods, _ = make(10)
    state = settled(rods, discrete_state(rods, 0, turn), DOWN)
    strain = frames(state).length[0] / rods.edge_length[0] - 1
    below = LENGTH - (np.arange(1, 10) + 0.5) * rods.edge_length[0]
    np.testing.assert_allclose(strain[1:], LINE_DENSITY * GRAVITY * below / rods.stretching[0], rtol=1e-3)


# Motion


def momenta(rods, state):
    """Linear and angular momentum (about the world's origin) of the first rod."""
    mass, spin = split(rods.inertia)
    v, rates = split(state.v)
    p = mass[0] * v[0]
    turning = (spin * rates)[0, :, None] * tangents(state.position)[0]
    return p.sum(axis=0), np.cross(state.position[0], p).sum(axis=0) + turning.sum(axis=0)


def tumbling(inextensible):
    rods, state = make(8, curvature=[1.0, 4.0, -2.0], free=True, inextensible=inextensible)
    arm = state.position - state.position.mean(axis=1, keepdims=True)
    v = np.array([0.3, -0.2, 0.1]) + np.cross([2.0, 8.0, -6.0], arm)
    spin = tangents(state.position) @ np.array([2.0, 8.0, -6.0])
    return rods, state._replace(v=join(v, spin))


@pytest.mark.parametrize("inextensible", [False, True])
def test_momentum_of_a_free_rod(inextensible):
    """Linear momentum to rounding; implicit Euler loses angular momentum in proportion to the step."""
    drifts = []
    for steps in (20, 40, 80):
        rods, state = tumbling(inextensible)
        before = momenta(rods, state)
        for _ in range(steps):
            state = implicit_step(rods, state, None, NOWHERE, 0.1 / steps)
        after = momenta(rods, state)
        np.testing.assert_allclose(after[0], before[0], rtol=0, atol=1e-12 * np.linalg.norm(before[0]))
        drifts.append(np.linalg.norm(after[1] - before[1]))
    assert 1.7 < drifts[0] / drifts[1] < 2.3
    assert 1.7 < drifts[1] / drifts[2] < 2.3


@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize("inextensible", [False, True])
def test_steps_create_no_energy(free, inextensible):
    rods, state = tangled(7, size=0.3, free=free, young=1e4, inextensible=inextensible)
    if inextensible:
        state = unstretched(rods, state)
    v = np.random.default_rng(1).normal(size=state.v.shape)
    v[:, : rods.prescribed] = 0
    state = state._replace(v=v)
    if inextensible:
        state = implicit_step(rods, state, None, NOWHERE, 1e-6)  # velocities that keep the lengths
    energies = []
    for _ in range(40):
        energies.append(total_energy(rods, state))
        state = implicit_step(rods, state, None, NOWHERE, 5e-3)
    energies = np.array(energies)
    assert np.diff(energies, axis=0).max() <= 1e-9 * energies[0].max()
    assert np.all(energies[-1] < 0.99 * energies[0])


def total_energy(rods, state, gravity=NOWHERE):
    return sum(discrete_energy(rods, state, gravity))


def unstretched(rods, state):
    """The same directions of the edges, with rest lengths."""
    edge = tangents(state.position) * rods.edge_length[:, None, None]
    first = state.position[:, :1]
    return state._replace(position=np.concatenate([first, first + np.cumsum(edge, axis=1)], axis=1))


def test_a_free_rod_falls_as_a_particle():
    rods, state = make(6, curvature=[1.0, 2.0, -1.0], free=True)
    start = np.array([1.0, 2.0, 3.0])
    moving = state._replace(v=join(np.broadcast_to(start, state.position.shape), np.zeros((1, 6))))
    dt, steps, end = 1e-2, 20, moving
    for _ in range(steps):
        end = implicit_step(rods, end, None, DOWN, dt)
    fallen = steps * dt * start + dt**2 * steps * (steps + 1) / 2 * DOWN
    np.testing.assert_allclose(end.position, state.position + fallen, rtol=0, atol=1e-10)


def test_lengths_are_kept():
    """Springs: to the weight and the swing over ES; rigid edges: to rounding, while the rod swings far."""
    gravity = 3 * DOWN
    stretches = {}
    for inextensible in (False, True):
        rods, state = make(10, inextensible=inextensible)
        worst = 0.0
        for _ in range(40):
            state = implicit_step(rods, state, None, gravity, 1e-2, tolerance=1e-8)
            worst = max(worst, abs(frames(state).length / rods.edge_length[:, None] - 1).max())
        stretches[inextensible] = worst
    assert state.position[0, -1, 2] < -0.7 * LENGTH
    load = 3 * LINE_DENSITY * GRAVITY * LENGTH / rods.stretching[0]
    assert 0.5 * load < stretches[False] < 5 * load
    assert stretches[True] < 1e-13


def test_rigid_edges_and_stiff_springs_swing_alike():
    ends = []
    for inextensible in (False, True):
        rods, state = make(8, inextensible=inextensible, curvature=[1.0, 3.0, 2.0])
        rods = rods._replace(stretching=100 * rods.stretching)
        for _ in range(20):
            state = implicit_step(rods, state, None, DOWN, 1e-2)
        ends.append(state.position[0])
    assert abs(ends[0] - ends[1]).max() < 1e-5 * LENGTH


# Prescribed roots


def test_a_rod_on_a_root_in_uniform_motion_does_not_know():
    rods, state = make(6, curvature=[1.0, 5.0, 2.0])
    velocity = np.array([[1.0, -2.0, 3.0]])
    carried = still(1)._replace(velocity=velocity)
    moving = state._replace(v=join(np.broadcast_to(velocity, state.position.shape), np.zeros((1, 6))))
    dt, steps = 1e-2, 10
    for _ in range(steps):
        state = implicit_step(rods, state, None, DOWN, dt)
        moving = implicit_step(rods, moving, carried, DOWN, dt)
    shift = moving.position - state.position
    np.testing.assert_allclose(shift, np.broadcast_to(steps * dt * velocity, shift.shape), atol=1e-9)


def test_a_turning_root_carries_a_stiff_rod_as_a_rigid_body():
    rods, state = make(5, young=1e5 * YOUNG, damping=1e-2, curvature=[2.0, 4.0, 1.0])
    start, dt, steps, rate = state, 5e-3, 40, 10.0
    frame = Rotation.from_rotvec([0.5, 1.0, 2.0])
    axis = frame.apply([0.0, 0.0, 1.0])
    turned = Rotation.identity()
    for k in range(steps):
        omega = rate * dt * (k + 1) * axis
        turned = Rotation.from_rotvec(dt * omega) * turned
        state = implicit_step(rods, state, still(1)._replace(angular_velocity=omega[None]), NOWHERE, dt)
    np.testing.assert_allclose(state.position[0], turned.apply(start.position[0]), atol=2e-3 * LENGTH)
    np.testing.assert_allclose(state.position[0, :2], turned.apply(start.position[0, :2]), atol=1e-12)
    directors = [material_director(s, tangents(s.position))[0][0, 0] for s in (start, state)]
    np.testing.assert_allclose(directors[1], turned.apply(directors[0]), atol=1e-10)


def test_points_move_as_their_jacobians_say():
    rods, state = tangled(5, edges=6)
    step = begin(rods, state, RootMotion(*np.random.default_rng(0).normal(size=(4, 2, 3))), DOWN, 1e-2)
    rod, s = np.array([0, 1, 1, 0]), np.array([0.0, 0.3, 1.5, 0.4])
    jacobian, drift = step.contact_points(rod, s)
    velocity = np.einsum("mij,mj->mi", jacobian, step.now.v[rod, 7:]) + drift
    before, after = (discrete_points(rods, x, rod, s)[0] for x in (step.before, step.now))
    np.testing.assert_allclose(velocity, (after - before) / step.dt, atol=1e-10)
    assert (abs(jacobian).sum(axis=1) > 0).sum(axis=1).max() <= 6


@pytest.mark.parametrize(
    ("rod", "s", "message"),
    [
        ([0], [1.2], "s must be an arc-length"),
        ([1], [np.nan], "s must be an arc-length"),
        ([-1], [0.1], r"rod must be in 0\.\.1"),
        ([2], [0.1], r"rod must be in 0\.\.1"),
        ([0, 1], [0.1], "vectors of one length"),
    ],
)
def test_points_off_the_rods_are_refused(rod, s, message):
    rods, state = tangled(5)
    with pytest.raises(ValueError, match=message):
        discrete_points(rods, state, rod, s)


# Contact


def incline(theta, mu, inextensible=False, steps=25, dt=4e-3):
    """A free rod laid along the slope of a plane inclined by theta."""
    turn = Rotation.from_rotvec([0.0, theta, 0.0]).as_matrix()
    rods = discrete_rods(
        length=0.1, radius=1e-3, young=1e8, poisson=0.3, density=1000.0, edges=6, free=True,
        inextensible=inextensible,
    )  # fmt: skip
    return Scene(
        name="incline",
        description="A rod on a slope.",
        rods=rods,
        state=discrete_state(rods, turn @ [0.0, 0.0, 1e-3], turn),
        bodies=[Body(np.zeros(3), obstacles=[Plane(np.zeros(3), turn @ [0.0, 0.0, 1.0])])],
        carrier=np.zeros(1, dtype=np.int64),
        dt=dt,
        steps=steps,
        mu_fibres=0.0,
        mu_obstacles=mu,
        tolerance=1e-8,
    )


def final(scene):
    *_, last = simulate(scene)
    return last


@pytest.mark.parametrize("mu", [0.1, 0.8])
@pytest.mark.parametrize("inextensible", [False, True])
@pytest.mark.parametrize("excess", [-0.01, 0.01, 0.3])
def test_a_rod_on_an_incline_sticks_or_slides_as_coulomb_says(mu, inextensible, excess):
    theta = math.atan(mu + excess) if excess > 0 else math.atan(mu) * (1 + excess)
    scene = incline(theta, mu, inextensible)
    last = final(scene)
    v = split(last.world.state.v)[0][0]
    speeds = np.linalg.norm(v, axis=1)
    if excess < 0:
        assert speeds.max() < 1e-4 * GRAVITY * last.world.time
        return
    expected = GRAVITY * (math.sin(theta) - mu * math.cos(theta)) * last.world.time
    np.testing.assert_allclose(speeds, expected, rtol=5e-3)


def test_the_incline_carries_the_weight():
    scene = incline(0.3, 0.5)
    last = final(scene)
    weight = scene.rods.line_density[0] * scene.rods.length[0] * GRAVITY
    total = last.world.impulses.sum(axis=0) / scene.dt
    np.testing.assert_allclose(total, [0, 0, weight], atol=1e-3 * weight)


@pytest.mark.parametrize("kind", ["wisp", "head", "plane", "cylinder", "twist", "comb"])
def test_every_kind_of_scene_runs_with_discrete_rods(kind):
    """The last problem of a step, solved, gives the step: momentum balance and Coulomb's law."""
    scene = replace(build(Parameters(kind, 10, "mixed", 0.3, 0.3, 1, model="discrete")), steps=8)
    scene = replace(scene, dt=4e-3) if scene.rods.free else scene
    assert scene.name.endswith("@discrete")
    steps = list(simulate(scene))
    stretch = frames(steps[-1].world.state).length / scene.rods.edge_length[:, None] - 1
    assert abs(stretch).max() < 1e-2
    for step in steps:
        if step.problem is None:
            continue
        problem = step.problem.condense()
        assert measure(problem, step.run.r).residual == pytest.approx(step.run.residual, rel=1e-6)
        v = step.problem.velocities(step.run.r)
        np.testing.assert_allclose(
            step.problem.H @ v + step.problem.w, problem.W @ step.run.r + problem.b, atol=1e-7
        )
        assert np.diff(step.problem.H.indptr).max() <= 12
        reached = step.world.state.v[:, scene.rods.prescribed :].ravel()
        np.testing.assert_allclose(reached, v, rtol=0, atol=1e-2 * abs(v).max())


def test_contacts_keep_the_momentum_of_two_free_rods_and_create_no_energy():
    scene = replace(
        build(Parameters("plane", 2, "straight", 0.5, 0.5, 1, model="discrete")), bodies=[Body(np.zeros(3))]
    )
    state = scene.state
    state.position[1] += state.position[0].mean(axis=0) - state.position[1].mean(axis=0) + [0, 0, 1.4e-3]
    v = np.zeros_like(state.position)
    v[1, :, 2] = -0.5
    scene = replace(
        scene, state=state._replace(v=join(v, np.zeros((2, 20)))), gravity=lambda t: NOWHERE, steps=12
    )
    mass = split(scene.rods.inertia)[0]
    momentum = [np.sum(mass * v, axis=(0, 1))]
    energies = [total_energy(scene.rods, scene.state).sum()]
    touched = 0
    for step in simulate(scene):
        touched += len(step.contacts.gap)
        momentum.append(np.sum(mass * split(step.world.state.v)[0], axis=(0, 1)))
        energies.append(total_energy(scene.rods, step.world.state).sum())
    assert touched > 0
    np.testing.assert_allclose(momentum, [momentum[0]] * 13, rtol=0, atol=1e-9 * abs(momentum[0]).max())
    assert np.diff(energies).max() <= 1e-6 * energies[0]
    assert energies[-1] < 0.99 * energies[0]


def test_a_belt_carries_a_rod_of_rigid_edges():
    scene = incline(0.0, 1.0, inextensible=True)
    belt = np.array([0.2, 0.0, 0.0])
    body = replace(scene.bodies[0], motion=lambda time: Motion(belt, np.zeros(3)))
    last = final(replace(scene, bodies=[body], steps=12))
    np.testing.assert_allclose(split(last.world.state.v)[0][0], np.broadcast_to(belt, (7, 3)), atol=1e-4)


@pytest.mark.parametrize("inextensible", [False, True])
def test_dumped_problems_are_those_of_the_steps(tmp_path, inextensible):
    scene = replace(incline(0.3, 0.5, inextensible), steps=3)
    rows = corpus.dump_scene(scene, tmp_path, count=2, fewest=1)
    steps = {step.index: step for step in simulate(scene)}
    for row in rows:
        found = read(tmp_path / row["file"])
        step = steps[row["step"]]
        problem = found.problem if inextensible else found.problem.condense()
        assert problem.content_hash() == step.problem.condense().content_hash()
        assert row["dofs"] == step.problem.d == 27


# Faults


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"edges": 1}, "edges must be at least 2"),
        ({"radius": -1.0}, "radius must be positive"),
        ({"curvature": np.nan}, "curvature must be finite"),
    ],
)
def test_material_out_of_range_is_an_error(options, message):
    with pytest.raises(ValueError, match=message):
        make(**({"edges": 4} | options))


def test_bad_arguments_are_errors():
    rods, state = make(4)
    with pytest.raises(ValueError, match="root_frame must be a rotation"):
        discrete_state(rods, 0, 2 * np.eye(3))
    with pytest.raises(ValueError, match="dt must be positive"):
        begin(rods, state, None, DOWN, 0.0)
    with pytest.raises(RuntimeError, match="not converged in 1 iterations"):
        implicit_step(rods, state, None, DOWN, 1e-2, iterations=1)
    with pytest.raises(SceneError, match=r"unknown rod model 'spline' \(known: helix, clothoid, discrete\)"):
        build("wisp-straight-19-mu0.3@spline")
