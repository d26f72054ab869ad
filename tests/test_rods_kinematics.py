"""Kinematics of rods against the ODE of frames, finite differences and refined rods."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from fibercontact.rods import (
    RootMotion,
    advance,
    centreline,
    circular_rods,
    dofs,
    inertia_matrix,
    point_jacobian,
    prescribed_velocity,
    rest_state,
    step_system,
)
from fibercontact.rods.motion import POINTS, sample
from fibercontact.rods.quadrature import gauss

ANGLES = [0.0, 1e-9, 1e-4, 0.05, 0.2, 1.5, 3.0]  # rotation per element, rad; 0.1 divides the two formulas
LENGTH, ELEMENTS = 0.7, 4


def make(free=False, angle=1.0, seed=0, count=2, elements=ELEMENTS):
    """Rods whose every element turns by `angle`, about random axes, with random roots and velocities."""
    rng = np.random.default_rng(seed)
    rods = circular_rods(
        length=np.full(count, LENGTH),
        radius=1e-2,
        young=1e6,
        poisson=0.3,
        density=1e3,
        elements=elements,
        free=free,
    )
    frames = Rotation.random(count, random_state=rng).as_matrix()
    state = rest_state(rods, rng.normal(size=(count, 3)), frames)
    axes = rng.normal(size=state.q.shape)
    q = angle * elements / LENGTH * axes / np.linalg.norm(axes, axis=2, keepdims=True)
    return rods, state._replace(q=q, v=rng.normal(size=(count, dofs(rods))))


def all_points(count, per_rod=13):
    s = np.linspace(0, LENGTH, per_rod)
    return np.repeat(np.arange(count), per_rod), np.tile(s, count)


def random_motion(seed, count=2):
    return RootMotion(*np.random.default_rng(seed).normal(size=(4, count, 3)))


def moved(state, root, t):
    """State at time t when the dofs keep their rates and the root follows `root`, both exact up to t²."""
    turn = t * root.angular_velocity + t**2 / 2 * root.angular_acceleration
    position = state.root_position + t * root.velocity + t**2 / 2 * root.acceleration
    v = state.v[:, -state.q[0].size :].reshape(state.q.shape)
    return state._replace(
        root_position=position,
        root_frame=Rotation.from_rotvec(turn).as_matrix() @ state.root_frame,
        q=state.q + t * v,
    )


@pytest.mark.parametrize("angle", ANGLES)
def test_frames_and_positions_solve_their_ode(angle):
    rods, state = make(angle=angle, count=1)
    breaks = np.linspace(0, LENGTH, ELEMENTS + 1)
    y = np.concatenate([state.root_position[0], state.root_frame[0].ravel()])
    for e, (a, b) in enumerate(pairwise(breaks)):
        tau, kappa1, kappa2 = state.q[0, e]
        skew = np.array([[0, -kappa2, kappa1], [kappa2, 0, -tau], [-kappa1, tau, 0]])

        def rates(_, y, skew=skew):
            F = y[3:].reshape(3, 3)
            return np.concatenate([F[:, 0], (F @ skew).ravel()])

        s = np.linspace(a, b, 4)
        path = solve_ivp(rates, (a, b), y, method="DOP853", t_eval=s, rtol=1e-12, atol=1e-13).y.T
        points = point_jacobian(rods, state, np.zeros(4, int), np.minimum(s, LENGTH))
        np.testing.assert_allclose(points.position, path[:, :3], rtol=0, atol=1e-10)
        np.testing.assert_allclose(points.frame.reshape(4, 9), path[:, 3:], rtol=0, atol=1e-10)
        y = path[-1]


@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize("angle", ANGLES)
def test_jacobian_is_the_derivative_of_the_position(angle, free):
    rods, state = make(free, angle)
    rod, s = all_points(2)
    jacobian = point_jacobian(rods, state, rod, s).jacobian
    h = 1e-5
    for d in range(dofs(rods)):
        v = np.zeros_like(state.v)
        v[:, d] = 1
        ahead, behind = (
            point_jacobian(rods, advance(rods, state, v, None, t), rod, s).position for t in (h, -h)
        )
        np.testing.assert_allclose(jacobian[:, :, d], (ahead - behind) / (2 * h), rtol=0, atol=2e-9)


@pytest.mark.parametrize("angle", [0.0, 1e-4, 0.5, 1.5, 2.3, 3.0])
def test_jacobian_obeys_the_stated_error_bound(angle):
    """An element cut in 16 is the same curve: its columns are the sums of the columns of the parts."""
    rods, state = make(angle=angle)
    fine, _ = make(angle=angle, elements=16 * ELEMENTS)
    fine_state = rest_state(fine)._replace(
        q=np.repeat(state.q, 16, axis=1),
        root_frame=state.root_frame,
        root_position=state.root_position,
    )
    rod, s = all_points(2)
    coarse_points = point_jacobian(rods, state, rod, s)
    fine_points = point_jacobian(fine, fine_state, rod, s)
    summed = fine_points.jacobian.reshape(-1, 3, ELEMENTS, 16, 3).sum(axis=3).reshape(-1, 3, 3 * ELEMENTS)
    np.testing.assert_allclose(coarse_points.position, fine_points.position, rtol=0, atol=1e-13)
    bound = 2e-15 + 1.7e-23 * (2 * angle) ** 16
    np.testing.assert_allclose(coarse_points.jacobian, summed, rtol=0, atol=bound * LENGTH**2)


@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize("angle", ANGLES)
def test_velocities_and_accelerations_are_time_derivatives(angle, free):
    """Second differences of the moving rod give gamma and alpha, prescribed root motion included."""
    rods, state = make(free, angle)
    root = random_motion(5)
    if free:
        zero = np.zeros((2, 3))
        root = RootMotion(state.v[:, :3], state.v[:, 3:6], zero, zero)
    samples = sample(rods, state, root)
    G = samples.position.shape[1]
    s = LENGTH / ELEMENTS * (np.arange(ELEMENTS)[:, None] + gauss(POINTS).nodes).ravel()
    rod, s = np.repeat([0, 1], G), np.tile(s, 2)
    h = 2e-4
    before, now, after = (point_jacobian(rods, moved(state, root, t), rod, s) for t in (-h, 0, h))

    def flat(x):
        return x.reshape(-1, 3)

    absolute = flat(samples.position + state.root_position[:, None])
    np.testing.assert_allclose(absolute, now.position, rtol=0, atol=1e-13)
    np.testing.assert_allclose(flat(samples.tangent), now.frame[:, :, 0], rtol=0, atol=1e-13)
    velocity = (after.position - before.position) / (2 * h)
    np.testing.assert_allclose(flat(samples.velocity), velocity, rtol=0, atol=2e-6)
    gamma = (after.position - 2 * now.position + before.position) / h**2
    np.testing.assert_allclose(flat(samples.acceleration), gamma, rtol=0, atol=2e-6 * (1 + abs(gamma).max()))
    turn = (after.frame - before.frame) / (2 * h) @ now.frame.transpose(0, 2, 1)
    np.testing.assert_allclose(flat(samples.angular_velocity), axial(turn), rtol=0, atol=2e-6)
    twist = (after.frame - 2 * now.frame + before.frame) / h**2 @ now.frame.transpose(0, 2, 1)
    np.testing.assert_allclose(flat(samples.angular_acceleration), axial(twist), rtol=0, atol=2e-6)


def axial(matrix):
    """Vector of the skew part of matrices (m, 3, 3)."""
    rows, columns = [2, 0, 1], [1, 2, 0]
    return (matrix[:, rows, columns] - matrix[:, columns, rows]) / 2


@pytest.mark.parametrize("angle", [0.0, 0.5, 1.5, 3.0])
def test_sampled_jacobians_obey_the_stated_error_bound(angle):
    rods, state = make(angle=angle)
    samples = sample(rods, state, random_motion(0))
    s = LENGTH / ELEMENTS * (np.arange(ELEMENTS)[:, None] + gauss(POINTS).nodes).ravel()
    J = point_jacobian(rods, state, np.repeat([0, 1], len(s)), np.tile(s, 2)).jacobian
    bound = 1e-14 + 6e-10 * (0.6 * angle) ** 8
    np.testing.assert_allclose(samples.jacobian.reshape(J.shape), J, rtol=0, atol=bound * LENGTH**2)


@pytest.mark.parametrize("free", [False, True])
def test_sampled_jacobians_give_the_velocities(free):
    rods, state = make(free)
    root = random_motion(1)
    samples = sample(rods, state, root)
    from_dofs = np.einsum("rgcd,rd->rgc", samples.jacobian, state.v)
    G = samples.position.shape[1]
    rod, position = np.repeat([0, 1], G), (samples.position + state.root_position[:, None]).reshape(-1, 3)
    prescribed = prescribed_velocity(rods, state, root, rod, position).reshape(from_dofs.shape)
    np.testing.assert_allclose(samples.velocity, from_dofs + prescribed, rtol=0, atol=1e-12)
    if free:
        turning = np.einsum("rgcd,rd->rgc", samples.turning, state.v)
        np.testing.assert_allclose(samples.angular_velocity, turning, rtol=0, atol=1e-12)
        assert not prescribed.any()


def test_inertia_is_the_integral_of_squared_jacobians():
    rods, state = make(angle=1.5)
    rule = gauss(12)
    s = LENGTH / ELEMENTS * (np.arange(ELEMENTS)[:, None] + rule.nodes).ravel()
    mass = rods.line_density[0] * LENGTH / ELEMENTS * np.tile(rule.weights, ELEMENTS)
    J = point_jacobian(rods, state, np.zeros(len(s), int), s).jacobian
    expected = np.einsum("g,gci,gcj->ij", mass, J, J)
    inertia = inertia_matrix(rods, state)[0]
    np.testing.assert_allclose(inertia, expected, rtol=0, atol=1e-7 * abs(expected).max())


@settings(max_examples=40, deadline=None)
@given(
    st.booleans(),
    st.floats(0, 3),
    st.integers(0, 10**6),
    st.floats(1e-5, 1e-1),
)
def test_step_matrix_is_symmetric_positive_definite(free, angle, seed, dt):
    rods, state = make(free, angle, seed)
    M, f = step_system(rods, state, random_motion(seed), np.array([0, 0, -9.81]), dt)
    np.testing.assert_allclose(M, M.transpose(0, 2, 1), rtol=1e-13, atol=1e-15 * abs(M).max())
    np.linalg.cholesky(M)
    assert np.all(np.isfinite(f))


@settings(max_examples=20, deadline=None)
@given(st.booleans(), st.floats(0, 3), st.integers(0, 10**6))
def test_a_rigid_displacement_of_the_root_carries_everything_along(free, angle, seed):
    rods, state = make(free, angle, seed)
    Q = Rotation.random(random_state=seed).as_matrix()
    turned = state._replace(root_position=state.root_position @ Q.T, root_frame=Q @ state.root_frame)
    rod, s = all_points(2)
    points, others = (point_jacobian(rods, x, rod, s) for x in (state, turned))
    np.testing.assert_allclose(others.position, points.position @ Q.T, rtol=0, atol=1e-13)
    np.testing.assert_allclose(others.frame, Q @ points.frame, rtol=0, atol=1e-13)
    root = 6 * free
    carried = Q @ points.jacobian[:, :, root:]
    np.testing.assert_allclose(others.jacobian[:, :, root:], carried, rtol=0, atol=1e-13)


def test_centreline_is_made_of_points_at_equal_arc_length():
    rods, state = make(angle=1.0)
    vertices = centreline(rods, state, 12)
    rod, s = all_points(2, 13)
    expected = point_jacobian(rods, state, rod, s).position
    np.testing.assert_allclose(vertices.reshape(-1, 3), expected, rtol=0, atol=1e-14)


def test_frames_stay_orthonormal_over_many_steps():
    rods, state = make(free=True)
    for k in range(300):
        state = advance(rods, state, np.sin(state.v + k), None, 0.05)
    F = state.root_frame
    np.testing.assert_allclose(F.transpose(0, 2, 1) @ F, np.tile(np.eye(3), (2, 1, 1)), rtol=0, atol=1e-15)


MATERIAL = {"length": 1.0, "radius": 0.1, "young": 1.0, "poisson": 0.3, "density": 1.0, "elements": 2}
BAD_MATERIAL = [
    ("length", 0.0),
    ("length", np.nan),
    ("radius", -1.0),
    ("young", np.inf),
    ("density", [1.0, 0.0]),
    ("poisson", 0.6),
    ("poisson", np.nan),
    ("damping", -1.0),
    ("elements", 0),
    ("curvature", np.inf),
]


@pytest.mark.parametrize(("name", "value"), BAD_MATERIAL)
def test_bad_material_is_named(name, value):
    with pytest.raises(ValueError, match=name):
        circular_rods(**MATERIAL | {name: value})


@pytest.mark.parametrize(
    ("rod", "s"),
    [
        ([2], [0.1]),
        ([-1], [0.1]),
        ([0], [-0.1]),
        ([0], [0.8]),
        ([0], [np.nan]),
        ([0, 1], [0.1]),
        ([[0]], [[0.1]]),
    ],
)
def test_points_off_the_rods_are_refused(rod, s):
    rods, state = make()
    with pytest.raises(ValueError, match="rod"):
        point_jacobian(rods, state, rod, s)


def test_bad_roots_steps_and_centrelines_are_refused():
    rods, state = make()
    for frame in (2 * np.eye(3), np.diag([1.0, 1.0, -1.0])):
        with pytest.raises(ValueError, match="rotation"):
            rest_state(rods, root_frame=frame)
    with pytest.raises(ValueError, match="dt"):
        step_system(rods, state, None, np.zeros(3), 0.0)
    with pytest.raises(ValueError, match="interval"):
        centreline(rods, state, 0)
