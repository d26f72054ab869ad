"""Kinematics of rods against the ODE of frames, finite differences and refined rods."""

from math import factorial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from fibercontact.rods import (
    CLOTHOID,
    HELIX,
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
both_bases = pytest.mark.parametrize("basis", [HELIX, CLOTHOID], ids=["helix", "clothoid"])


def make(basis, free=False, angle=1.0, seed=0, count=2, elements=ELEMENTS):
    """Rods whose every element turns by `angle` (at most), about random axes, with random roots and velocities."""
    rng = np.random.default_rng(seed)
    rods = circular_rods(
        length=np.full(count, LENGTH),
        radius=1e-2,
        young=1e6,
        poisson=0.3,
        density=1e3,
        elements=elements,
        free=free,
        basis=basis,
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


def curvature(basis, q, e, xi):
    """Curvature at `xi` in element e of a rod with coefficients `q` (N, 3)."""
    return (1 - xi) * q[e] + xi * q[e + 1] if basis == CLOTHOID else q[e]


def frame_path(basis, state, s):
    """Positions and frames of the first rod at the m arc-lengths `s` of every element, (E, m, 12), by its ODE."""
    element, y = LENGTH / ELEMENTS, np.concatenate([state.root_position[0], state.root_frame[0].ravel()])

    def rates(x, y, e):
        tau, kappa1, kappa2 = curvature(basis, state.q[0], e, x / element)
        F, skew = y[3:].reshape(3, 3), [[0, -kappa2, kappa1], [kappa2, 0, -tau], [-kappa1, tau, 0]]
        return np.concatenate([F[:, 0], (F @ skew).ravel()])

    for e in range(ELEMENTS):
        span = (0, element)
        path = solve_ivp(rates, span, y, args=(e,), method="DOP853", t_eval=s, rtol=1e-12, atol=1e-13).y.T
        yield path
        y = path[-1]


@both_bases
@pytest.mark.parametrize("angle", ANGLES)
def test_frames_and_positions_solve_their_ode(angle, basis):
    rods, state = make(basis, angle=angle, count=1)
    s = np.linspace(0, LENGTH / ELEMENTS, 4)
    for e, path in enumerate(frame_path(basis, state, s)):
        at = np.minimum(e * LENGTH / ELEMENTS + s, LENGTH)
        points = point_jacobian(rods, state, np.zeros(4, int), at)
        np.testing.assert_allclose(points.position, path[:, :3], rtol=0, atol=1e-10)
        np.testing.assert_allclose(points.frame.reshape(4, 9), path[:, 3:], rtol=0, atol=1e-10)


@both_bases
@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize("angle", ANGLES)
def test_jacobian_is_the_derivative_of_the_position(angle, free, basis):
    rods, state = make(basis, free, angle)
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


def derivative(n, theta, beta):
    """`n!` times the coefficient of x^n in `exp(theta x + beta x²/2)`."""
    powers = (
        (theta ** (n - 2 * k) * (beta / 2) ** k, factorial(k) * factorial(n - 2 * k))
        for k in range(n // 2 + 1)
    )
    return factorial(n) * sum(power / below for power, below in powers)


def error_bound(rods, state, n, share=1.0):
    """The bound that `kinematics` and `motion` state: a Gauss rule with n nodes over a share of an element."""
    coefficient = factorial(n) ** 4 / ((2 * n + 1) * factorial(2 * n) ** 3)
    element = LENGTH / ELEMENTS
    theta = 2 * share * element * np.linalg.norm(state.q, axis=2).max()
    if rods.basis == HELIX:
        return coefficient * derivative(2 * n, theta, 0)
    beta = 2 * share**2 * element * np.linalg.norm(np.diff(state.q, axis=1), axis=2).max()
    return coefficient * (derivative(2 * n, theta, beta) + share * 2 * n * derivative(2 * n - 1, theta, beta))


def refinement(basis, parts):
    """Matrix P with `q_fine = P q` for the same curve with every element cut in `parts`."""
    if basis == HELIX:
        return np.repeat(np.eye(ELEMENTS), parts, axis=0)
    nodes = np.arange(ELEMENTS + 1)
    fine = np.linspace(0, ELEMENTS, parts * ELEMENTS + 1)
    return np.column_stack([np.interp(fine, nodes, hat) for hat in np.eye(ELEMENTS + 1)])


@both_bases
@pytest.mark.parametrize("angle", [0.0, 1e-4, 0.5, 1.5, 2.3, 3.0])
def test_jacobian_obeys_the_stated_error_bound(angle, basis):
    """An element cut in 16 is the same curve: its columns are combinations of those of the parts."""
    rods, state = make(basis, angle=angle)
    fine, _ = make(basis, angle=angle, elements=16 * ELEMENTS)
    P = refinement(basis, 16)
    fine_state = rest_state(fine)._replace(
        q=np.einsum("fn,rni->rfi", P, state.q),
        root_frame=state.root_frame,
        root_position=state.root_position,
    )
    rod, s = all_points(2)
    coarse_points = point_jacobian(rods, state, rod, s)
    fine_points = point_jacobian(fine, fine_state, rod, s)
    columns = fine_points.jacobian.reshape(len(s), 3, -1, 3)
    combined = np.einsum("mcfi,fn->mcni", columns, P).reshape(coarse_points.jacobian.shape)
    np.testing.assert_allclose(coarse_points.position, fine_points.position, rtol=0, atol=1e-13)
    bound = 2e-15 + error_bound(rods, state, 8)
    np.testing.assert_allclose(coarse_points.jacobian, combined, rtol=0, atol=bound * LENGTH**2)


@both_bases
@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize("angle", ANGLES)
def test_velocities_and_accelerations_are_time_derivatives(angle, free, basis):
    """Second differences of the moving rod give gamma and alpha, prescribed root motion included."""
    rods, state = make(basis, free, angle)
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


@both_bases
@pytest.mark.parametrize("angle", [0.0, 0.5, 1.5, 3.0])
def test_sampled_jacobians_obey_the_stated_error_bound(angle, basis):
    rods, state = make(basis, angle=angle)
    samples = sample(rods, state, random_motion(0))
    s = LENGTH / ELEMENTS * (np.arange(ELEMENTS)[:, None] + gauss(POINTS).nodes).ravel()
    J = point_jacobian(rods, state, np.repeat([0, 1], len(s)), np.tile(s, 2)).jacobian
    bound = 1e-14 + error_bound(rods, state, 4, share=0.3)
    np.testing.assert_allclose(samples.jacobian.reshape(J.shape), J, rtol=0, atol=bound * LENGTH**2)


@both_bases
@pytest.mark.parametrize("free", [False, True])
def test_sampled_jacobians_give_the_velocities(free, basis):
    rods, state = make(basis, free, angle=0.2)  # the two integrations agree to rounding
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


@both_bases
def test_inertia_is_the_integral_of_squared_jacobians(basis):
    rods, state = make(basis, angle=1.5)
    rule = gauss(12)
    s = LENGTH / ELEMENTS * (np.arange(ELEMENTS)[:, None] + rule.nodes).ravel()
    mass = rods.line_density[0] * LENGTH / ELEMENTS * np.tile(rule.weights, ELEMENTS)
    J = point_jacobian(rods, state, np.zeros(len(s), int), s).jacobian
    expected = np.einsum("g,gci,gcj->ij", mass, J, J)
    inertia = inertia_matrix(rods, state)[0]
    np.testing.assert_allclose(inertia, expected, rtol=0, atol=1e-7 * abs(expected).max())


@both_bases
@settings(max_examples=40, deadline=None)
@given(
    free=st.booleans(),
    angle=st.floats(0, 3),
    seed=st.integers(0, 10**6),
    dt=st.floats(1e-5, 1e-1),
)
def test_step_matrix_is_symmetric_positive_definite(basis, free, angle, seed, dt):
    rods, state = make(basis, free, angle, seed)
    M, f = step_system(rods, state, random_motion(seed), np.array([0, 0, -9.81]), dt)
    np.testing.assert_allclose(M, M.transpose(0, 2, 1), rtol=1e-13, atol=1e-15 * abs(M).max())
    np.linalg.cholesky(M)
    assert np.all(np.isfinite(f))


@both_bases
@settings(max_examples=20, deadline=None)
@given(free=st.booleans(), angle=st.floats(0, 3), seed=st.integers(0, 10**6))
def test_a_rigid_displacement_of_the_root_carries_everything_along(basis, free, angle, seed):
    rods, state = make(basis, free, angle, seed)
    Q = Rotation.random(random_state=seed).as_matrix()
    turned = state._replace(root_position=state.root_position @ Q.T, root_frame=Q @ state.root_frame)
    rod, s = all_points(2)
    points, others = (point_jacobian(rods, x, rod, s) for x in (state, turned))
    np.testing.assert_allclose(others.position, points.position @ Q.T, rtol=0, atol=1e-13)
    np.testing.assert_allclose(others.frame, Q @ points.frame, rtol=0, atol=1e-13)
    root = 6 * free
    carried = Q @ points.jacobian[:, :, root:]
    np.testing.assert_allclose(others.jacobian[:, :, root:], carried, rtol=0, atol=1e-13)


@both_bases
@pytest.mark.parametrize("points", [1, 2, 7, 12])
def test_centreline_is_made_of_points_at_equal_arc_length(points, basis):
    rods, state = make(basis, angle=1.0)
    vertices = centreline(rods, state, points)
    rod, s = all_points(2, points + 1)
    expected = point_jacobian(rods, state, rod, s).position
    np.testing.assert_allclose(vertices.reshape(-1, 3), expected, rtol=0, atol=1e-14)


def test_frames_stay_orthonormal_over_many_steps():
    rods, state = make(HELIX, free=True)
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
    ("basis", 2),
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
    rods, state = make(HELIX)
    with pytest.raises(ValueError, match="rod"):
        point_jacobian(rods, state, rod, s)


def test_bad_roots_steps_and_centrelines_are_refused():
    rods, state = make(HELIX)
    for frame in (2 * np.eye(3), np.diag([1.0, 1.0, -1.0])):
        with pytest.raises(ValueError, match="rotation"):
            rest_state(rods, root_frame=frame)
    with pytest.raises(ValueError, match="dt"):
        step_system(rods, state, None, np.zeros(3), 0.0)
    with pytest.raises(ValueError, match="interval"):
        centreline(rods, state, 0)
