"""Theorems about one contact, and every exact local solver against them, over the whole space of inputs.

Symbols of THEORY §1; e is the value of the natural map (THEORY §2). By Moreau's decomposition `sigma r - e` lies in
`K_mu`, `ũ - e` in `K_mu*`, and they are orthogonal: an answer with a small e obeys every clause of the law, and what
follows from it, to within `‖e‖` times the sizes of the factors.
"""

import math

import numba
import numpy as np
import oracle_mp
import oracles
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from test_local_solvers import EXACT, HONEST, residual, solve

from fibercontact.local.contract import Status

STICK_FIRST = [
    "enum-quartic",
    "enum-companion",
    "hybrid",
    "secular",
]  # they try take-off, then stick, then slip
EPS = np.finfo(np.float64).eps

# ---- the space of inputs

ANGLES = st.one_of(st.sampled_from([0.0, math.pi / 4, 1e-8]), st.floats(0, 2 * math.pi))
FRICTION = st.one_of(st.sampled_from([0.0, 1e-12, 1e-6, 0.5, 1.0, 100.0]), st.floats(0, 10))
TINY = st.sampled_from([0.0, -0.0, 5e-324, -5e-324, 1e-300, -1e-300, 1e-16, -1e-16, -1e-8])
PARTS = st.floats(-1, 1).map(lambda x: x if abs(x) > 1e-30 else 0.0)


@st.composite
def matrices(draw, condition):
    """SPD, of any condition number up to the given one, of any scale.

    Rotated anyhow, about the normal only (`W_NT = 0`), or not at all.
    """
    least = -math.log10(condition)
    powers = st.one_of(st.sampled_from([0.0, least]), st.floats(least, 0))
    eigenvalues = 10.0 ** np.array([0.0, draw(powers), draw(powers)])[draw(st.permutations(range(3)))]
    Q = np.eye(3)
    rotation = draw(st.sampled_from(["any", "about the normal", "none"]))
    if rotation != "none":
        Q = oracles.turned(draw(ANGLES))
    if rotation == "any":
        about_T2 = np.roll(oracles.turned(draw(ANGLES)), (2, 2), (0, 1))
        Q = Q @ about_T2 @ oracles.turned(draw(ANGLES))
    W = 10.0 ** draw(st.integers(-12, 12)) * (Q * eigenvalues @ Q.T)
    W = 0.5 * (W + W.T)
    assume(np.linalg.eigvalsh(W)[0] > 0)
    return W


@st.composite
def velocities(draw, W, mu):
    """Free velocities: any, with a tiny normal part, zero, or stopped by an impulse in, on or outside the cone."""
    kind = draw(st.sampled_from(["any", "any", "grazing", "zero", "edge"]))
    if kind == "zero":
        return np.zeros(3)
    size = 10.0 ** draw(st.integers(-12, 12))
    if kind == "edge":
        reach = draw(st.sampled_from([0.0, 0.5, 1.0, 1 - 1e-9, 1 + 1e-9, 2.0]))
        return -size / np.trace(W) * W @ impulse(mu * reach, draw(ANGLES))
    b = size * np.array([draw(TINY if kind == "grazing" else PARTS), draw(PARTS), draw(PARTS)])
    assume(np.linalg.norm(b) > 1e-100)  # or its square is not a number
    return b


def impulse(slope, angle):
    return np.array([1.0, slope * np.cos(angle), slope * np.sin(angle)])


@st.composite
def contacts(draw, condition=1e14, friction=FRICTION):
    """`(W, b, mu, start)`."""
    W, mu = draw(matrices(condition)), draw(friction)
    b = draw(velocities(W, mu))
    far = np.array([draw(PARTS), draw(PARTS), draw(PARTS)]) * 10.0 ** draw(st.integers(-3, 6))
    return W, b, mu, draw(st.sampled_from([0.0, 1.0])) * far * np.linalg.norm(b) / np.trace(W)


def claims(contact, names=EXACT):
    """The answers that solvers claim to be right, by name; the others are not judged."""
    answers = {name: solve(name, *contact) for name in names}
    return {name: r for name, (status, r) in answers.items() if status == Status.CONVERGED}


def worth(W, b, mu, r):
    """What a claim promises of `‖e‖`: the tolerance, and what rounding r and u can leave of it."""
    return HONEST * np.linalg.norm(b) + 8 * (1 + mu) * EPS * np.trace(W) * np.linalg.norm(r)


def precise_size(W, b, mu, r):
    """`‖e‖` by 50 digits."""
    return float(oracle_mp.residual(W, b, mu, r)) * (np.linalg.norm(b) or 1.0)


# ---- claims

SLIVER = oracles.turned(0.7) @ np.diag([1e-3, 1.0, 1e-10]) @ oracles.turned(-0.7)
EDGE = np.array(
    [
        [1.0, 0.0, 0.0],
        [0.0, 0.4481013476955003, -0.4972813326008627],
        [0.0, -0.4972813326008627, 0.551930915720278],
    ]
)
PITFALLS = [
    (np.eye(3), np.array([-5e-324, 1.0, 0.0]), 1.0, np.zeros(3)),  # b_N/W_NN times anything is zero
    (np.eye(3), np.array([-1e-305, 1.0, 0.0]), 1e-6, np.zeros(3)),  # the bracket of alpha overflows
    (np.diag([1e-3, 1.0, 1.0]), np.array([-10.0, 0.0, 10.0]), 2.2e-311, np.zeros(3)),  # 1/mu overflows
    (SLIVER, -SLIVER @ [1.0, 30.0, 50.0], 100.0, np.zeros(3)),  # Cramer's rule for stick
    (np.diag([1e-7, 1.0, 1e-7]), np.array([-0.97, -0.02, 0.97]), 0.5, np.zeros(3)),  # the smaller root of MFB
    (EDGE, -EDGE @ impulse(1e-3 * (1 + 1e-15), 4.97660889628574), 1e-3, np.zeros(3)),  # alpha = 0 to rounding
]


@given(contacts())
@example(PITFALLS[0])
@example(PITFALLS[1])
@example(PITFALLS[2])
@example(PITFALLS[3])
@example(PITFALLS[4])
@example(PITFALLS[5])
def test_a_claim_is_true(contact):
    """Honesty: what is claimed is finite and obeys the law, judged by 50 digits; for any SPD `W` to 1e14."""
    for name, r in claims(contact).items():
        assert np.isfinite(r).all(), name
        assert precise_size(*contact[:3], r) <= worth(*contact[:3], r), name


@pytest.mark.skipif(
    bool(numba.config.DISABLE_JIT), reason="Python raises an exception when it divides by zero"
)
@pytest.mark.parametrize("name", EXACT)
@given(
    st.lists(st.floats(), min_size=9, max_size=9), st.floats(), st.lists(st.floats(), min_size=3, max_size=3)
)
def test_no_doubles_break_a_solver(name, numbers, mu, start):
    """NaN, infinite, subnormal, `W` indefinite, mu < 0: no exception, and no claim about or of what is not finite."""
    W = np.array([numbers[:3], [numbers[1], *numbers[3:5]], [numbers[2], numbers[4], numbers[5]]])
    status, r = solve(name, W, numbers[6:], mu, start)
    assert status != Status.CONVERGED or np.isfinite([*numbers, mu, *r]).all()


@given(contacts(9e9, st.one_of(st.sampled_from([0.0, 1e-12, 1e-6, 1.0, 10.0]), st.floats(0, 10))))
@example(PITFALLS[0])
@example(PITFALLS[1])
@example(PITFALLS[2])
@example(PITFALLS[5])
def test_a_solution_exists_and_is_found(contact):
    """Existence: for SPD `W` and mu >= 0 there is a solution [Acary, Cadoux, Lemaréchal & Malick 2011, ZAMM 91].

    The two steady solvers find one from any start, for condition numbers to 1e9 and mu to 10.
    """
    for name in ("hybrid", "secular"):
        assert solve(name, *contact)[0] == Status.CONVERGED, name


# ---- the clauses of the law, and what follows from them


@given(contacts())
def test_a_contact_takes_off_if_and_only_if_it_parts(contact):
    """`r = 0` is a solution iff `b_N >= 0` (THEORY §1): solvers that test for it give exactly it, then only."""
    b = contact[1]
    for name, (status, r) in {name: solve(name, *contact) for name in STICK_FIRST}.items():
        if b[0] >= 0:
            assert status == Status.CONVERGED, name
            assert (r == 0).all(), name
        elif status == Status.CONVERGED and -b[0] > HONEST * np.linalg.norm(b):
            assert r[0] > 0, name


@given(contacts())
def test_signorini(contact):
    """`0 <= u_N ⟂ r_N >= 0`, and r in its cone (THEORY §1)."""
    W, b, mu, _ = contact
    for name, r in claims(contact).items():
        u, x, small = W @ r + b, np.trace(W) / 3 * r, worth(W, b, mu, r)
        assert x[0] >= -small, name
        assert np.hypot(x[1], x[2]) <= mu * x[0] + (1 + mu) * small, name
        assert u[0] >= -(1 + mu) * small, name
        assert abs(u[0] * x[0]) <= 2 * (1 + mu) * small * (np.linalg.norm(u) + np.linalg.norm(x)), name


@given(contacts())
def test_friction_dissipates_the_most_it_can(contact):
    """Maximal dissipation: `u_T·r_T <= u_T·q` for all q of the disc `mu r_N`. So friction creates no power."""
    W, b, mu, _ = contact
    for name, r in claims(contact).items():
        u, x = W @ r + b, np.trace(W) / 3 * r
        tolerance = 4 * (1 + mu) ** 2 * worth(W, b, mu, r) * (np.linalg.norm(u) + np.linalg.norm(x))
        assert u[1:] @ x[1:] <= -mu * x[0] * np.linalg.norm(u[1:]) + tolerance, name
        assert u[1:] @ x[1:] <= tolerance, name


@given(contacts())
def test_the_law_in_one_line(contact):
    """`K_mu* ∋ ũ ⟂ r ∈ K_mu` with `ũ = u + mu ‖u_T‖ e` [De Saxcé & Feng 1998]."""
    W, b, mu, _ = contact
    for name, r in claims(contact).items():
        u, x, small = W @ r + b, np.trace(W) / 3 * r, worth(W, b, mu, r)
        sliding = np.linalg.norm(u[1:])
        changed = np.array([u[0] + mu * sliding, u[1], u[2]])
        assert mu * sliding <= changed[0] + (1 + mu) * small, name
        assert abs(changed @ x) <= 2 * small * (np.linalg.norm(changed) + np.linalg.norm(x)), name


@given(contacts())
def test_an_impact_gains_no_energy(contact):
    """`½ uᵀW⁻¹u - ½ bᵀW⁻¹b = ½ r·(u + b) <= 0`: by the law `r·u <= 0`, and `r·(b - u) = -rᵀW r`."""
    W, b, mu, _ = contact
    for name, r in claims(contact).items():
        u, x = W @ r + b, np.trace(W) / 3 * r
        tolerance = 8 * (1 + mu) ** 2 * worth(W, b, mu, r) * (np.linalg.norm(u) + np.linalg.norm(x))
        assert x @ (u + b) <= tolerance, name


@given(contacts(friction=st.just(0.0)))
def test_without_friction_only_the_normal_matters(contact):
    """mu = 0: `r = (max(0, -b_N/W_NN), 0, 0)`."""
    W, b, mu, _ = contact
    expected = np.array([max(0.0, -b[0] / W[0, 0]), 0.0, 0.0])
    for name, r in claims(contact).items():
        assert W[0, 0] * np.linalg.norm(r - expected) <= 6 * worth(W, b, mu, r), name


@given(matrices(1e8), st.floats(0.01, 10), st.floats(0, 0.99), ANGLES, st.floats(1, 1e3))
def test_what_sticks_does_not_know_its_friction(W, mu, reach, angle, more):
    """`-W⁻¹b` has no mu in it: in the cone of mu, it is the answer for every larger mu too, bit for bit."""
    b = -W @ impulse(mu * reach, angle)
    for name in STICK_FIRST:
        (status, r), (again, same) = solve(name, W, b, mu), solve(name, W, b, more * mu)
        assert status == again == Status.CONVERGED, name
        np.testing.assert_array_equal(same, r, err_msg=name)


# ---- little friction: one solution, and how far from it an answer can be


def coupling(W):
    """`kappa / mu = sqrt(lambda_max(W_TT) (W⁻¹)_NN)`: Cadoux's loop contracts by kappa; unique solution if < 1."""
    return np.sqrt(np.linalg.eigvalsh(W[1:, 1:])[-1] * np.linalg.inv(W)[0, 0])


@st.composite
def gentle(draw, condition):
    """Contacts with `kappa <= 0.9`, and their kappa."""
    W, kappa = draw(matrices(condition)), draw(st.floats(0.01, 0.9))
    mu = kappa / coupling(W)
    return W, draw(velocities(W, mu)), mu, kappa


def error_bound(W, kappa, size):
    """Distance in the norm of W to the solution r°, from any r at which `‖e‖ = size`.

    `r - e/sigma` solves the convex problem of the slip term `‖u_T(r)‖` and of `b + W e/sigma - e`, and so
    `(1 - kappa) ‖r - e/sigma - r°‖_W <= (1 + kappa) ‖e‖_W/sigma + ‖e‖_W⁻¹`, as in the proof of uniqueness.
    """
    eigenvalues = np.linalg.eigvalsh(W)
    in_W, in_inverse = 3 * size * np.sqrt(eigenvalues[-1]) / np.trace(W), size / np.sqrt(eigenvalues[0])
    return in_W + ((1 + kappa) * in_W + in_inverse) / (1 - kappa)


def energy_norm(W, x):
    return np.sqrt(max(0.0, x @ W @ x))


@given(gentle(1e10))
def test_an_answer_is_as_near_the_solution_as_its_residual_says(contact):
    """kappa < 1: there is one solution, and every claim is within `error_bound` of it; both by 50 digits."""
    W, b, mu, kappa = contact
    (solution,) = oracle_mp.coulomb_solutions(W, b, mu)
    for name, r in claims(contact[:3]).items():
        size = precise_size(W, b, mu, r)
        gap = np.array([float(c - oracle_mp.number(x)) for c, x in zip(solution.r, r, strict=True)])
        assert size <= worth(W, b, mu, r), name
        assert energy_norm(W, gap) <= 1.001 * error_bound(W, kappa, size), name


@given(gentle(1e6), ANGLES)
def test_answers_turn_with_the_tangents(contact, angle):
    """A rotation Q of the tangents: `Q W Qᵀ` and `Q b` have the solution `Q r`, where it is unique."""
    W, b, mu, kappa = contact
    Q = oracles.turned(angle)
    turned = claims((Q @ W @ Q.T, Q @ b, mu))
    for name, r in claims((W, b, mu)).items():
        if name in turned:
            size = worth(W, b, mu, r) + worth(W, b, mu, turned[name])
            assert energy_norm(W, Q.T @ turned[name] - r) <= error_bound(W, kappa, size), name


@given(gentle(1e6), st.tuples(PARTS, PARTS, PARTS), st.sampled_from([1.0, 1e-3, 1e-6]))
def test_answers_depend_on_b_continuously(contact, way, much):
    """kappa < 1: `‖r - r'‖_W <= (1 + kappa)/(1 - kappa) ‖b - b'‖_W⁻¹`, by the optimality of the convex problems."""
    W, b, mu, kappa = contact
    other = b + much * np.linalg.norm(b) * np.array(way)
    d, moved = other - b, claims((W, other, mu))
    lipschitz = (1 + kappa) / (1 - kappa) * np.sqrt(d @ np.linalg.solve(W, d))
    for name, r in claims((W, b, mu)).items():
        if name in moved:
            size = sum(
                residual(name, W, c, mu, x) * np.linalg.norm(c) for c, x in ((b, r), (other, moved[name]))
            )
            size += 100 * EPS * (np.linalg.norm(b) + np.trace(W) * np.linalg.norm(r))
            assert energy_norm(W, moved[name] - r) <= 1.001 * lipschitz + error_bound(W, kappa, size), name


# ---- strong friction: several solutions


@given(contacts(100.0, st.floats(0, 10)))
def test_an_answer_is_near_one_of_the_solutions(contact):
    """Forward error `C eps cond`, but near a double root of `phi`, which is known to the root of that only."""
    W, b, mu, _ = contact
    solutions = [np.array([float(c) for c in s.r]) for s in oracle_mp.coulomb_solutions(W, b, mu)]
    for name, r in claims(contact).items():
        nearest = min(np.linalg.norm(W @ (r - s)) for s in solutions) / (np.linalg.norm(b) or 1.0)
        size = max(residual(name, W, b, mu, r), EPS * np.linalg.cond(W))
        assert nearest <= 100 * np.sqrt(size), name
