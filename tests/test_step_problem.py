"""The incremental problem, the problem of a step and its condensation, against dense linear algebra."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.sparse import block_diag, bsr_array, coo_array, csc_array, csr_array, diags_array

from fibercontact.problem.constrained import ConstrainedStep
from fibercontact.problem.incremental import IncrementalProblem, ProblemError, ProblemWarning
from fibercontact.problem.mobility import Mobility
from fibercontact.problem.step import StepProblem


def definite(rng, size):
    A = rng.standard_normal((size, size))
    return A @ A.T + 0.1 * np.eye(size)


def random_step(seed, rods, touched, scramble=False):
    """Rods of the given numbers of dofs; contact i moves the rods touched[i], some of their dofs only."""
    rng = np.random.default_rng(seed)
    start = np.concatenate([[0], np.cumsum(rods)])
    H = np.zeros((3 * len(touched), start[-1]))
    for i, on in enumerate(touched):
        for rod in on:
            first = rng.integers(start[rod], start[rod + 1])
            H[3 * i : 3 * i + 3, first : start[rod + 1]] = rng.standard_normal((3, start[rod + 1] - first))
    M = block_diag([definite(rng, size) for size in rods], format="csr")
    order = rng.permutation(start[-1]) if scramble else np.arange(start[-1])
    return StepProblem(
        csr_array(M)[order][:, order].tocsr(),
        rng.standard_normal(start[-1]),
        csr_array(H[:, order]),
        rng.standard_normal(3 * len(touched)),
        rng.uniform(0, 1, len(touched)),
    )


@st.composite
def steps(draw, most_contacts=8):
    rods = draw(st.lists(st.integers(1, 7), min_size=1, max_size=4))
    on = st.lists(st.integers(0, len(rods) - 1), min_size=1, max_size=3, unique=True)
    touched = draw(st.lists(on, min_size=0, max_size=most_contacts))
    return random_step(draw(st.integers(0, 2**32 - 1)), rods, touched, draw(st.booleans()))


def incremental(n=4, seed=0):
    return random_step(seed, [3 * n], [[0]] * n).condense()


@settings(deadline=None)
@given(steps())
def test_condensation_is_that_of_dense_algebra(step):
    problem = step.condense()
    M, H, W = step.M.toarray(), step.H.toarray(), problem.W.toarray()
    expected = H @ np.linalg.solve(M, H.T)
    scale = np.abs(expected).max(initial=1.0)
    np.testing.assert_allclose(W, expected, rtol=0, atol=1e-10 * scale)
    np.testing.assert_array_equal(W, W.T)
    assert np.linalg.eigvalsh(W).min(initial=0.0) >= -1e-12 * scale
    np.testing.assert_allclose(problem.b, step.w - H @ np.linalg.solve(M, step.f), atol=1e-9 * scale)


@settings(deadline=None)
@given(steps(), st.integers(0, 1000))
def test_velocities_solve_the_step_and_give_the_velocities_of_the_contacts(step, seed):
    r = np.random.default_rng(seed).standard_normal(3 * step.n)
    v = step.velocities(r)
    np.testing.assert_allclose(step.M @ v + step.f, step.H.T @ r, atol=1e-9)
    problem = step.condense()
    np.testing.assert_allclose(step.H @ v + step.w, problem.W @ r + problem.b, atol=1e-8)


@pytest.mark.parametrize("scramble", [False, True])
def test_blocks_are_stored_exactly_where_contacts_share_a_rod(scramble):
    touched = [[0, 1], [1, 2], [3], [0, 3], [2], [0, 1]]
    W = random_step(1, [4, 3, 5, 2], touched, scramble).condense().W
    stored = {(i, int(j)) for i, (a, c) in enumerate(pairwise(W.indptr)) for j in W.indices[a:c]}
    assert stored == {(i, j) for i in range(6) for j in range(6) if set(touched[i]) & set(touched[j])}


@pytest.mark.parametrize("width", [1, 3])
def test_a_long_banded_rod_keeps_its_envelope(width):
    d = 200
    band = [np.full(d - abs(k), -1.0) for k in range(-width, width + 1) if k]
    M = diags_array(
        [np.full(d, 2.5 * width), *band], offsets=[0, *(k for k in range(-width, width + 1) if k)]
    ).tocsr()
    mobility = Mobility(M)
    assert len(mobility.factor.L) <= d * (width + 1)
    x = np.random.default_rng(0).standard_normal(d)
    np.testing.assert_allclose(M @ mobility.solve(x), x, atol=1e-12)


def test_a_step_without_contacts_moves_freely():
    step = random_step(3, [2, 3], [])
    problem = step.condense()
    assert problem.n == 0
    assert problem.W.shape == (0, 0)
    assert problem.b_ref == 0
    assert problem.sigma.shape == (0,)
    np.testing.assert_allclose(step.M @ step.velocities(np.zeros(0)), -step.f, atol=1e-12)


def test_an_indefinite_rod_is_named():
    step = random_step(0, [3, 4], [[0], [1]])
    M = step.M.toarray()
    M[5, 5] = -1.0
    with pytest.raises(ProblemError, match="not positive definite: rod 1, degree of freedom 5"):
        replace(step, M=csr_array(M)).condense()


def test_what_is_too_large_for_the_memory_is_refused_before_it_is_allocated():
    d, n = 600_000, 400_000
    first, rest = np.zeros(d - 1, dtype=int), np.arange(1, d)
    head = coo_array((np.ones(2 * d - 2), (np.append(first, rest), np.append(rest, first))), (d, d))
    arrow = diags_array(np.full(d, 2.0 * d)) + head
    with pytest.raises(ProblemError, match=r"the factor of M needs 1.34e\+03 GiB"):
        Mobility(csr_array(arrow))
    pendulum = StepProblem(
        csr_array([[1.0]]), np.zeros(1), csr_array(np.ones((3 * n, 1))), np.zeros(3 * n), np.zeros(n)
    )
    with pytest.raises(ProblemError, match=r"W needs 1.07e\+04 GiB"):
        pendulum.condense()
    chain = StepProblem(
        diags_array(np.ones(d)).tocsr(),
        np.zeros(d),
        csr_array(np.eye(3, 1) @ np.eye(1, d)),
        np.zeros(3),
        np.zeros(1),
    )
    with pytest.raises(ProblemError, match=r"the elimination of bilateral constraints needs 8.05e\+03 GiB"):
        ConstrainedStep(chain, csr_array(np.ones((d, 1))), np.zeros(1)).condense()


def test_a_singular_rod_is_refused():
    ones = csr_array(np.kron(np.eye(2), np.ones((3, 3))))
    with pytest.raises(ProblemError, match="rod 0, degree of freedom 1"):
        Mobility(ones)


def spoilt(array, at, value):
    array = array.copy()
    array[at] = value
    return array


STEP_FAULTS = {
    "mu is negative .* at contact 1": lambda p: {"mu": spoilt(p.mu, 1, -0.1)},
    "mu is not finite .* at contact 0": lambda p: {"mu": spoilt(p.mu, 0, np.nan)},
    "w is not finite .* at contact 1": lambda p: {"w": spoilt(p.w, 4, np.inf)},
    r"w must have shape \(6,\)": lambda p: {"w": p.w[:-1]},
    "w must be a float64 array": lambda p: {"w": p.w.astype(int)},
    "f is not finite .* at degree of freedom 2": lambda p: {"f": spoilt(p.f, 2, np.nan)},
    r"M must have shape \(6, 6\)": lambda p: {"f": p.f[:-1]},
    "M must be a float64 CSR": lambda p: {"M": p.M.tocsc()},
    "H must have shape": lambda p: {"H": p.H[:-3]},
    "H is not finite": lambda p: {"H": p.H * np.inf},
    "M is not symmetric": lambda p: {"M": csr_array(np.triu(p.M.toarray()))},
    "contact 1 moves no degree of freedom": lambda p: {"H": csr_array(spoilt(p.H.toarray(), slice(3, 6), 0))},
}


@pytest.mark.parametrize("fault", STEP_FAULTS)
def test_a_faulty_step_is_refused_by_name(fault):
    step = random_step(2, [3, 4], [[0], [0, 1]])
    with np.errstate(invalid="ignore"), pytest.raises(ProblemError, match=fault):
        replace(step, **STEP_FAULTS[fault](step))


def without_block(W, i):
    keep = np.ones(len(W.indices), dtype=bool)
    keep[i * (len(W.indptr) - 1) + i] = False  # every block is stored
    indptr = np.concatenate([[0], np.cumsum(np.diff(W.indptr) - np.eye(len(W.indptr) - 1, dtype=int)[i])])
    return bsr_array((W.data[keep], W.indices[keep], indptr), shape=W.shape)


def with_value(W, row, column, value):
    dense = spoilt(W.toarray(), (row, column), value)
    dense[column, row] = value
    return bsr_array(dense, blocksize=(3, 3))


INCREMENTAL_FAULTS = {
    "mu is negative .* at contact 3": lambda p: {"mu": spoilt(p.mu, 3, -1.0)},
    "b is not finite .* at contact 2": lambda p: {"b": spoilt(p.b, 8, np.nan)},
    r"b must have shape \(12,\)": lambda p: {"b": p.b.reshape(4, 3)},
    "W must be a float64 BSR": lambda p: {"W": p.W.tocsr()},
    r"W must have shape \(9, 9\)": lambda p: {"mu": p.mu[:3], "b": p.b[:9]},
    "W is not finite in the block of contacts 1 and 2": lambda p: {"W": with_value(p.W, 4, 7, np.nan)},
    "W has no diagonal block at contact 2": lambda p: {"W": without_block(p.W, 2)},
    "diagonal block of W at contact 0 is zero": lambda p: {"W": with_value(p.W, 0, 0, -1e9)},
    "W is not symmetric: see the blocks of contacts 0 and 1": lambda p: {
        "W": bsr_array(spoilt(p.W.toarray(), (1, 4), 7.0), blocksize=(3, 3))
    },
}


@pytest.mark.parametrize("fault", INCREMENTAL_FAULTS)
def test_a_faulty_incremental_problem_is_refused_by_name(fault):
    problem = incremental()
    with pytest.raises(ProblemError, match=fault):
        replace(problem, **INCREMENTAL_FAULTS[fault](problem))


def test_unsorted_blocks_are_refused():
    W = incremental(2).W
    order = np.array([1, 0, 3, 2])
    turned = bsr_array((W.data[order], W.indices[order], W.indptr), shape=W.shape)
    with pytest.raises(ProblemError, match="sorted"):
        IncrementalProblem(turned, np.zeros(6), np.zeros(2))


def test_derived_quantities_follow_their_definitions():
    problem = incremental()
    W = problem.W.toarray()
    for i in range(problem.n):
        block = W[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
        np.testing.assert_array_equal(problem.diagonal[i], block)
        assert problem.sigma[i] == pytest.approx(np.trace(block) / 3)
    assert problem.b_ref == pytest.approx(np.sqrt(np.mean(np.sum(problem.b.reshape(-1, 3) ** 2, axis=1))))


@pytest.mark.parametrize("form", [np.asarray, csr_array, csc_array, coo_array, bsr_array])
def test_every_form_of_the_same_problem_has_one_hash(form):
    problem = incremental()
    again = IncrementalProblem.from_sparse(form(problem.W.toarray()), problem.b, problem.mu)
    assert again.content_hash() == problem.content_hash()


def test_hash_sees_every_number_and_no_storage():
    problem = random_step(5, [3, 4, 3], [[0], [1], [0, 1], [2]]).condense()
    full = IncrementalProblem(bsr_array(problem.W.toarray() + 0.0, blocksize=(3, 3)), problem.b, problem.mu)
    hollow = bsr_array((np.zeros((16, 3, 3)), np.tile(np.arange(4), 4), np.arange(0, 17, 4)), shape=(12, 12))
    for i in range(4):
        for j in range(4):
            hollow.data[4 * i + j] = problem.W.toarray()[3 * i : 3 * i + 3, 3 * j : 3 * j + 3]
    hollow.data[hollow.data == 0] = -0.0
    padded = IncrementalProblem(hollow, problem.b, problem.mu)
    assert len(hollow.indices) > len(problem.W.indices)
    assert full.content_hash() == padded.content_hash() == problem.content_hash()
    changed = [
        replace(problem, b=spoilt(problem.b, 3, np.nextafter(problem.b[3], 9))),
        replace(problem, mu=spoilt(problem.mu, 0, 0.123)),
        replace(problem, W=with_value(problem.W, 0, 1, 0.123)),
    ]
    assert len({p.content_hash() for p in (problem, *changed)}) == 4


def test_asymmetry_is_averaged_with_a_warning_or_refused():
    problem = incremental()
    W = problem.W.toarray()
    largest = np.abs(W).max()
    W[0, 5] += 1e-4 * largest
    with pytest.raises(ProblemError, match=r"relative asymmetry 1\.0e-04"):
        IncrementalProblem.from_sparse(W, problem.b, problem.mu)
    with pytest.warns(ProblemWarning, match=r"a\.hdf5: W is asymmetric by 1\.0e-04"):
        averaged = IncrementalProblem.from_sparse(W, problem.b, problem.mu, symmetrise=True, source="a.hdf5")
    np.testing.assert_allclose(averaged.W.toarray(), (W + W.T) / 2, rtol=1e-15)
    with pytest.raises(ProblemError, match="not symmetric"):
        IncrementalProblem.from_sparse(np.tril(W), problem.b, problem.mu, symmetrise=True)


def test_asymmetry_of_rounding_is_averaged_quietly(recwarn):
    problem = incremental()
    W = problem.W.toarray()
    W[0, 5] *= 1 + 1e-14
    again = IncrementalProblem.from_sparse(W, problem.b, problem.mu)
    np.testing.assert_array_equal(again.W.toarray(), again.W.toarray().T)
    assert not [told for told in recwarn if issubclass(told.category, ProblemWarning)]


@pytest.mark.parametrize("shape", [(3, 6), (4, 4)])
def test_a_matrix_of_the_wrong_size_is_refused(shape):
    with pytest.raises(ProblemError, match="multiple of 3"):
        IncrementalProblem.from_sparse(np.ones(shape), np.zeros(3), np.zeros(1))


def kkt_velocities(step, G, c, r):
    """Contact velocities from the whole saddle-point system, the slow way."""
    M, H = step.M.toarray(), step.H.toarray()
    none = np.zeros((len(c), len(c)))
    v_lambda = np.linalg.solve(np.block([[M, -G], [G.T, none]]), np.concatenate([H.T @ r - step.f, -c]))
    return H @ v_lambda[: step.d] + step.w


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.booleans())
def test_bilateral_constraints_are_eliminated_exactly(seed, count, scramble):
    step = random_step(seed, [5, 6, 7], [[0, 1], [1], [2], [0, 2]], scramble)
    rng = np.random.default_rng(seed + 1)
    G = np.zeros((18, count))
    for constraint in range(count):  # one or two rods each
        G[rng.choice(18, 4, replace=False), constraint] = rng.uniform(0.5, 2, 4) * rng.choice([-1, 1], 4)
    assume(np.linalg.cond(G) < 1e3)
    c, r = rng.standard_normal(count), rng.standard_normal(12)
    problem = ConstrainedStep(step, csr_array(G), c).condense()
    np.testing.assert_allclose(problem.W @ r + problem.b, kkt_velocities(step, G, c, r), rtol=1e-6, atol=1e-6)


def test_without_constraints_the_condensation_is_the_plain_one():
    step = random_step(4, [5, 3], [[0, 1], [1]])
    plain, constrained = step.condense(), ConstrainedStep(step, csr_array((8, 0)), np.zeros(0)).condense()
    np.testing.assert_allclose(constrained.W.toarray(), plain.W.toarray(), rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(constrained.b, plain.b, atol=1e-12)


@pytest.mark.parametrize(
    "G",
    [
        np.outer(np.arange(1.0, 9.0), [1.0, 2.0]),
        np.stack([np.arange(1.0, 9.0), np.zeros(8)], axis=1),
        np.ones((8, 9)),
    ],
)
def test_dependent_constraints_are_refused(G):
    step = random_step(4, [5, 3], [[0, 1], [1]])
    with pytest.raises(ProblemError, match="G is rank deficient"):
        ConstrainedStep(step, csr_array(G), np.zeros(G.shape[1])).condense()
