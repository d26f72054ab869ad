"""The synthetic hard set: its answers obey Coulomb's law in exact arithmetic, its difficulties are there."""

from decimal import Decimal, localcontext
from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np
import oracles
import pytest

from fibercontact.bench.contact_verdict import judge
from fibercontact.local.hard_set import FAMILIES, hard_set
from fibercontact.local.one_contact import read, replay
from fibercontact.local.registry import configure, registered

ANSWER_LIMIT = 1e10
"""sigma |r| / |b| beyond which no solver is asked for an answer."""


@cache
def contacts():
    return hard_set()


def family(name):
    found = contacts().select(contacts().family == f"known: {name}")
    assert found.m > 0
    return found


def answer_size(c):
    return c.sigma * np.linalg.norm(c.answer, axis=1) / np.linalg.norm(c.b, axis=1)


def det(W):
    a, b, c, d, e, f = (Fraction(W[i, j]) for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))
    return a * (d * f - e * e) - b * (b * f - e * c) + c * (b * e - d * c)


def exact_natural_map(W, b, mu, r):
    """`|sigma r - P_K(sigma r - ũ)|` and `|b|` with 150 digits, written from THEORY §2."""
    W, b, r, mu = (
        [[Decimal(x) for x in row] for row in W],
        [Decimal(x) for x in b],
        [Decimal(x) for x in r],
        Decimal(mu),
    )
    u = [sum(a * x for a, x in zip(row, r, strict=True)) + c for row, c in zip(W, b, strict=True)]
    sigma = (W[0][0] + W[1][1] + W[2][2]) / 3
    x = [sigma * c for c in r]
    y = [u[0] + mu * (u[1] ** 2 + u[2] ** 2).sqrt(), u[1], u[2]]
    z = [p - q for p, q in zip(x, y, strict=True)]
    t = (z[1] ** 2 + z[2] ** 2).sqrt()
    if t <= mu * z[0]:
        p = z
    elif mu * t <= -z[0]:
        p = [Decimal(0)] * 3
    else:
        normal = (z[0] + mu * t) / (1 + mu**2)
        p = [normal, mu * normal * z[1] / t, mu * normal * z[2] / t]
    return sum((a - c) ** 2 for a, c in zip(x, p, strict=True)).sqrt(), sum(c**2 for c in b).sqrt()


def test_every_answer_is_one_to_the_rounding_of_b():
    c = contacts()
    with localcontext() as context:
        context.prec = 150
        for k in range(c.m):
            data = c.W[k].tolist(), c.b[k].tolist(), float(c.mu[k]), c.answer[k].tolist()
            size, load = exact_natural_map(*data)
            assert size <= (1 + Decimal(data[2])) * load / 2**53 + Decimal(10) ** -140, c.family[k]


def test_impulses_are_in_the_cone_and_slips_on_its_boundary_exactly():
    for W, b, mu, r in zip(contacts().W, contacts().b, contacts().mu, contacts().answer, strict=True):
        N, T1, T2, m = (Fraction(float(x)) for x in (*r, mu))
        assert N >= 0
        limit, size = m * m * N * N, T1 * T1 + T2 * T2
        assert size <= limit
        sliding = np.linalg.norm((W @ r + b)[1:]) > 1e-6 * np.linalg.norm(b)
        if N > 0 and m > 0 and sliding and np.trace(W) * np.linalg.norm(r) < 1e8 * np.linalg.norm(b):
            assert size == limit


def test_the_committed_file_holds_the_same_set():
    committed = read(Path(__file__).parents[1] / "problems" / "one_contact.h5")
    known = committed.select(np.char.startswith(committed.family, "known: "))
    for name in ("W", "b", "mu", "start", "family", "answer"):
        np.testing.assert_array_equal(getattr(known, name), getattr(contacts(), name))


def test_every_family_is_there():
    assert list(dict.fromkeys(contacts().family)) == [f"known: {name}" for name in FAMILIES]


@pytest.mark.parametrize("name", ["condition, slip", "condition, stick", "impulse along the weak axis"])
def test_condition_numbers_go_from_nearly_1_to_1e14(name):
    decades = np.log10(family(name).condition)
    low = 0 if name.startswith("condition") else 1
    assert set(np.round(decades)) >= set(range(low, 15))


def test_impulses_along_the_weak_axis_are_larger_than_b_by_the_condition_number():
    c = family("impulse along the weak axis")
    assert (answer_size(c) > 0.01 * c.condition).all()


def test_friction_goes_from_0_to_100():
    mu = family("friction").mu
    assert mu.min() == 0
    assert mu.max() == 100
    assert len(np.unique(mu)) == 11


def test_normal_loads_are_on_both_sides_of_0():
    below, above = family("b_N just below 0"), family("b_N at 0 and above")
    ratio = -below.b[:, 0] / (below.W[:, 0, 0] * below.answer[:, 0])
    assert ratio.min() > 0
    assert ratio.min() < 1e-12
    assert (above.b[:, 0] == 0).any()
    assert above.b[:, 0].min() == 0
    assert 0 < above.b[above.b[:, 0] > 0, 0].min() < 1e-15
    assert (above.answer == 0).all()


def test_the_edge_of_stick_and_slip_is_approached_from_both_sides():
    c = family("stick/slip edge")
    share = np.linalg.norm(c.answer[:, 1:], axis=1) / (c.mu * c.answer[:, 0])
    assert (share[share < 1 - 1e-15] > 0.98).all()
    assert (1 - share[share < 1 - 1e-15]).min() < 1e-14
    sliding = np.linalg.norm((np.einsum("kij,kj->ki", c.W, c.answer) + c.b)[:, 1:], axis=1)
    assert ((sliding > 1e-15) & (sliding < 1e-12)).any()


def test_the_edge_of_slip_and_take_off_is_approached_from_both_sides():
    c = family("slip/take-off edge")
    size = answer_size(c)
    assert ((size > 0) & (size < 1e-14)).any()
    assert ((size == 0) & (c.b[:, 0] > 0) & (c.b[:, 0] < 1e-15)).any()
    assert ((size == 0) & (c.b[:, 0] == 0)).any()


@pytest.mark.parametrize(("name", "multiplicity", "h"), [("double root", 2, 2e-3), ("triple root", 3, 1e-2)])
def test_roots_are_as_multiple_as_said(name, multiplicity, h):
    """`phi(alpha (1 + h))` falls by `2^multiplicity` when h is halved, for the contacts without a gap."""
    c = family(name)
    for k in range(96):
        W, b, mu, r = c.W[k], c.b[k], c.mu[k], c.answer[k]
        u = W @ r + b
        alpha = -u[1:] @ r[1:] / (r[1:] @ r[1:])

        def phi(h, W=W, b=b, mu=mu, alpha=alpha):
            x = oracles.slip_impulse(W, b, alpha * (1 + h))
            return np.linalg.norm(x[1:]) - mu * x[0]

        ratios = [phi(2 * h) / phi(h) for h in (h, -h)]
        assert np.mean(ratios) == pytest.approx(2**multiplicity, rel=0.1)


@pytest.mark.parametrize(
    ("name", "rank"), [("singular, rank 2", 2), ("singular, rank 1", 1), ("singular, W_NN only", 1)]
)
def test_singular_operators_are_exactly_so(name, rank):
    c = family(name)
    for W in c.W:
        assert det(W) == 0
        assert np.linalg.matrix_rank(W) <= rank
        assert W[0, 0] > 0
    assert max(np.linalg.matrix_rank(W) for W in c.W) == rank


def test_uncoupled_contacts_are_so():
    c = family("W_NT = 0")
    assert (c.W[:, 0, 1:] == 0).all()
    assert (c.W[:, 1, 1] == c.W[:, 2, 2]).any()


def test_scales_go_from_1e_12_to_1e12():
    c = family("scales")
    for decades in (np.log10(c.sigma), np.log10(np.linalg.norm(c.b, axis=1))):
        assert decades.min() < -11
        assert decades.max() > 11


def test_bad_starts_are_bad():
    c = family("bad start")
    off = np.linalg.norm(c.start - c.answer, axis=1) / np.linalg.norm(c.start, axis=1)
    assert np.mean(off > 0.1) > 0.95  # a stick without tangential load turned round is itself
    assert (c.start[:, 0] < 0).any()
    assert (np.abs(c.start).max(axis=1) > 1e11).any()


@pytest.mark.parametrize("name", ["secular", "hybrid"])
def test_steady_solvers_do_not_fail_up_to_1e10_and_mu_10(name):
    c = contacts().select((contacts().condition <= 1e10) & (contacts().mu <= 10))
    assert c.m > 4000
    local = configure(name, registered())
    verdict = judge(c, replay(local, c), local.facets)
    assert sorted(set(c.family[~verdict.solved])) == []


@pytest.mark.parametrize("name", ["secular", "hybrid"])
def test_beyond_that_they_fail_only_where_the_answer_is_out_of_bounds(name):
    local = configure(name, registered())
    verdict = judge(contacts(), replay(local, contacts()), local.facets)
    assert (answer_size(contacts())[~verdict.solved] > ANSWER_LIMIT / 3).all()
