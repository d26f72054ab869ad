"""What `explain` finds out: rates, periods, failing contacts that are known beforehand, and what it says of them."""

import math
import re
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import oracles
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numba.core import config
from scipy.sparse import csr_array, eye_array
from typer.testing import CliRunner

from fibercontact.bench import explain, problem_set, visits
from fibercontact.bench.explain import (
    GROWING,
    LARGE,
    Attempt,
    attempts,
    contact_properties,
    decay_of,
    examine,
    failures_of,
    fallback_of,
    fewest,
    growth_of,
    motion_of,
    next_change,
    periods_of,
    residual_by_contact,
    telling,
)
from fibercontact.bench.explain_figure import draw
from fibercontact.bench.explain_words import title, words
from fibercontact.bench.passes import lay_out, logged
from fibercontact.bench.problem_set import find_problem
from fibercontact.bench.protocol import BenchError
from fibercontact.bench.visits import VisitRecord
from fibercontact.cli import app
from fibercontact.gauss_seidel.solver import LOOPS, GaussSeidel
from fibercontact.gauss_seidel.visit_log import RECENT
from fibercontact.jit import jit
from fibercontact.local.contract import LocalSolver, Status
from fibercontact.local.registry import Configured, configure, registered
from fibercontact.problem.fclib import read, write
from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.problem.step import StepProblem

PLUGIN = """
'''Does nothing.'''
from fibercontact.jit import jit
from fibercontact.local.contract import LocalSolver

@jit
def kernel(W, b, mu, r, options):
    return 4, r, 0

solver = LocalSolver(kernel)
"""

ABOUT = {
    "problem": "made-up", "problem_hash": "0", "solver": "secular", "law_facets": 0, "accuracy": "mid",
    "tolerance": 1e-4, "start": "cold", "outer": "plain", "max_sweeps": 50, "max_seconds": 10.0, "outcome": "sweeps",
    "residual": 1e-2, "solved": False, "reason": "outer", "detail": "", "proximal_from": 0,
}  # fmt: skip


@cache
def local(name):
    return configure(name, registered())


# How the residual went


@given(rate=st.floats(0.5, 0.999), sweeps=st.integers(20, 2000))
def test_a_known_contraction_factor_is_found(rate, sweeps):
    k = np.arange(sweeps + 1)
    residual = np.maximum(rate**k, 1e-300)
    k, residual = k[residual > 1e-250], residual[residual > 1e-250]
    if residual[len(k) // 2 :].min() > 0.9 * residual[: (len(k) + 1) // 2].min():
        return  # hardly anything in half the run counts as stalled
    tolerance = residual[-1] * rate**10.5
    found = decay_of(k, residual, tolerance)
    assert found.kind == "geometric"
    assert found.rate == pytest.approx(rate, rel=1e-6)
    assert found.to_go == pytest.approx(10.5, rel=1e-3)
    assert decay_of(k, residual, residual[-1]).to_go == 0.0


@given(power=st.floats(0.2, 3.0), sweeps=st.integers(40, 5000))
def test_a_known_power_of_the_sweeps_is_found(power, sweeps):
    k = np.arange(sweeps + 1)
    residual = np.maximum(k, 0.5) ** -power
    found = decay_of(k, residual, residual[-1] / 2)
    assert found.kind == "algebraic"
    assert found.rate == pytest.approx(power, rel=1e-6)
    assert found.last + found.to_go == pytest.approx(sweeps * 2 ** (1 / power), rel=1e-6)


def test_runs_that_get_nowhere_are_told_apart():
    k = np.arange(101)
    flat = np.where(k < 20, 0.5**k, 0.5**20)
    assert decay_of(k, flat, 1e-9).kind == "stalled"
    assert decay_of(k, flat, 1e-9).to_go == math.inf
    risen = np.where(k < 60, 0.9**k, 0.9**60 * 1.1 ** (k - 60.0))
    assert decay_of(k, risen, 1e-9).kind == "uneven"
    assert decay_of(k[:4], flat[:4], 1e-9).kind == "short"
    assert decay_of(k[:1], flat[:1], 1e-9).kind == "short"
    assert decay_of(k, np.where(k == 100, np.nan, flat), 1e-9).kind == "stalled"


def test_growth_is_that_of_a_known_power():
    k = np.arange(1001)
    size = np.concatenate([[np.nan], 0.5 * k[1:] ** 0.7])
    found = growth_of(k, size)
    assert found.size == size[-1]
    assert found.factor == pytest.approx(2**0.7)
    assert found.power == pytest.approx(0.7)
    assert found.unbounded
    assert not growth_of(k, np.full(1001, 50.0)).unbounded
    assert not growth_of(k, size / size[-1] * (LARGE - 1)).unbounded
    assert growth_of(k, LARGE * (GROWING + 0.01) ** (k / 500.0)).unbounded
    assert growth_of(np.array([0]), np.array([np.nan])).factor == 1.0


# Cycles and drifts


@pytest.mark.parametrize("period", [2, 3, 7, 16, 32])
def test_a_known_period_is_found(period):
    rng = np.random.default_rng(period)
    once = rng.normal(size=(period, 1, 3))
    x = np.concatenate([once] * (RECENT // period + 1))[:RECENT]
    assert periods_of(x).tolist() == [period]
    assert periods_of(x + 1e-3 * rng.normal(size=x.shape)).tolist() == [period]


def test_periods_of_columns_are_their_own():
    k = np.arange(RECENT)
    x = np.zeros((RECENT, 5, 3))
    x[:, 0, 1] = (-1.0) ** k
    x[:, 1, 2] = k % 5
    x[:, 2, 0] = k  # a drift
    x[:, 3, 0] = np.random.default_rng(0).normal(size=RECENT)
    assert periods_of(x).tolist() == [2, 5, 0, 0, 0]
    assert periods_of(x[:, :2].reshape(RECENT, 1, -1)).tolist() == [10]


def test_an_oscillation_that_dies_out_slowly_is_a_cycle_and_a_decay_is_none():
    k = np.arange(RECENT)[:, None, None]
    assert periods_of((-0.99) ** k * np.ones((1, 1, 3))).tolist() == [2]
    assert periods_of(0.9**k * np.ones((1, 1, 3))).tolist() == [0]


def record(n=6, recent=None, moving=None, **changes):
    """A record of an invented run of n contacts, with some values given."""
    sweeps = np.arange(51)
    recent = np.zeros((RECENT, n, 3)) if recent is None else recent
    moving = np.arange(n) if moving is None else moving
    amplitude = np.zeros(n)
    amplitude[moving] = np.linalg.norm(recent - recent[-1], axis=2).max(axis=0)
    visit = np.zeros(0, dtype=np.dtype([("contact", "i4")]))
    statuses = np.zeros((n, len(Status)), dtype=np.int64)
    statuses[:, 0] = 50
    counts = np.tile([n - 2, 1, 1, 0, 5, 0], (51, 1))
    counts[0] = 0
    values = {
        "about": ABOUT, "sweeps": sweeps, "residual": 0.9**sweeps, "size": np.ones(51), "counts": counts,
        "statuses": statuses, "switches": np.zeros(n, dtype=np.int64), "visits": visit, "failures": visit,
        "amplitude": amplitude, "moving": moving, "recent": recent, "answer": np.ones(3 * n),
    }  # fmt: skip
    return VisitRecord(**(values | changes))


def test_motion_is_told_by_kind():
    k = np.arange(RECENT, dtype=float)
    scale, mu = np.ones(6), np.full(6, 0.5)
    x = np.zeros((RECENT, 6, 3))
    assert motion_of(record(recent=x), scale, mu, 1e-4).kind == "still"
    x[:, 4, 0] = 1e-7 * k  # below a hundredth of the tolerance but for the last sweeps' sum
    assert motion_of(record(recent=x), scale, mu, 1e-2).kind == "still"
    x[:, 1, 1] = 0.3 * (-1.0) ** k
    x[:, 2, 2] = 0.2 * (k % 3)
    cycle = motion_of(record(recent=x), scale, mu, 1e-2)
    assert (cycle.kind, cycle.period) == ("cycle", 6)
    assert dict(zip(cycle.contacts.tolist(), cycle.periods.tolist(), strict=True)) == {1: 2, 2: 3}
    assert cycle.movers.tolist() == [1, 2]
    assert motion_of(record(recent=x[-3:]), scale, mu, 1e-2).kind == "short"
    wander = np.cumsum(np.random.default_rng(1).normal(size=(RECENT, 6, 3)), axis=0)
    assert motion_of(record(recent=wander), scale, mu, 1e-4).kind == "wander"


def test_motion_does_not_depend_on_units():
    rng = np.random.default_rng(2)
    x = np.concatenate([rng.normal(size=(4, 6, 3))] * 16)
    sigma = 10.0 ** np.arange(6)
    mu = np.ones(6)
    plain = motion_of(record(recent=x), np.ones(6), mu, 1e-4)
    amplitude = record(recent=x).amplitude
    other = motion_of(record(recent=x / sigma[:, None], amplitude=amplitude), sigma, mu, 1e-4)
    assert (plain.kind, plain.period) == (other.kind, other.period) == ("cycle", 4)
    assert plain.straightness == pytest.approx(other.straightness)


@pytest.mark.parametrize(
    ("r", "speed", "mu", "expected"),
    [
        ([2.0, 0.0, 0.0], [-0.01, 0.0, 0.0], 0.5, (1, "open", 200.0)),
        ([2.0, 0.4, 0.3], [0.0, 0.004, 0.003], 0.5, (1, "slip", 100.0)),  # |r_T| = 0.5 grows by 0.005 up to 1
        ([2.0, 0.5, 0.0], [-0.01, 0.0, 0.0], 0.5, (1, "slip", 100.0)),  # mu r_N = 1 falls to 0.5
        ([2.0, 1.0, 0.0], [-0.01, -0.005, 0.0], 0.5, (1, "open", 200.0)),  # slips all the way to the tip
        ([2.0, 0.4, 0.3], [0.01, 0.0, 0.0], 0.5, None),
        ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0], 0.5, None),
    ],
)
def test_a_drift_leads_to_the_next_change_of_regime(r, speed, mu, expected):
    ages = np.arange(RECENT, dtype=float)[::-1, None]
    x = np.zeros((RECENT, 2, 3))
    x[:, 0] = [5.0, 0.0, 0.0]
    x[:, 1] = np.array(r) - ages * np.array(speed)
    found = next_change(x, np.array([0, 1]), np.array([mu, mu]))
    if expected is None:
        assert found is None
    else:
        assert found[:2] == expected[:2]
        assert found.sweeps == pytest.approx(expected[2], rel=1e-6)


def test_the_contact_that_changes_is_named_by_its_number():
    x = np.ones((RECENT, 1, 3)) * [1.0, 0.0, 0.0] - 0.01 * np.arange(RECENT)[:, None, None] * [1.0, 0.0, 0.0]
    found = motion_of(record(recent=x, moving=np.array([4])), np.ones(6), np.ones(6), 1e-4)
    assert found.kind == "drift"
    assert found.straightness == pytest.approx(1.0)
    assert (found.change.contact, found.change.regime) == (4, "open")
    assert found.change.sweeps == pytest.approx((1.0 - 0.63) / 0.01)


@pytest.mark.skipif(config.DISABLE_JIT, reason="a million visits")
def test_a_change_of_regime_of_a_real_plateau_is_foretold():
    """Thousands of sweeps without one, then the contact that was named, about when it was said."""
    problem = find_problem("cylinder-straight-40-mu0.1-070")
    laid = lay_out(read(problem.file).problem)
    about = ABOUT | {"tolerance": 1e-8}

    def run(sweeps):
        return logged(GaussSeidel(local("secular"), 1e-8, sweeps, **LOOPS["plain"]), laid, None, about)[2]

    record = run(4000)
    motion = examine(record, laid, local("secular"), local("secular")).motion
    assert motion.kind == "drift"
    assert record.counts[2000:, 5].sum() == 0
    before, later = (run(4000 + int(f * motion.change.sweeps)) for f in (0.7, 1.1))
    assert (before.switches == record.switches).all()
    assert np.flatnonzero(later.switches != record.switches).tolist() == [motion.change.contact]


# Where things sit


def test_the_fewest_that_hold_most():
    assert fewest(np.array([1.0, 7.0, 0.0, 2.0])).tolist() == [1, 3]
    assert fewest(np.array([1.0, 7.0, 0.0, 2.0]), 0.7).tolist() == [1]
    assert fewest(np.array([9, 1])).tolist() == [0]
    assert fewest(np.zeros(3)).tolist() == []
    assert fewest(np.ones(10)).tolist() == list(range(9))


def test_a_property_that_tells_a_group_is_found_and_chance_is_not():
    rng = np.random.default_rng(0)
    properties = {"noise": rng.random(200), "size": rng.random(200), "slightly": rng.random(200)}
    group, others = np.arange(20), np.arange(20, 200)
    assert telling(properties, group, others) == ("", 0.5)
    properties["size"][group] -= 0.9
    name, share = telling(properties, group, others)
    pairs = properties["size"][group][:, None] > properties["size"][others]
    assert name == "size"
    assert share == pytest.approx(pairs.mean())
    assert share < 0.2
    assert telling(properties, np.array([0]), others) == ("", 0.5)  # one contact may be extreme by chance
    assert telling(properties, group, others[:0]) == ("", 0.5)


def test_properties_are_those_of_the_blocks():
    problem = oracles.strands(0).condense()
    found = contact_properties(problem)
    assert "mu" not in found  # the same everywhere
    W = problem.W.toarray()
    for i in range(problem.n):
        block = W[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
        assert found["condition of W_ii"][i] == pytest.approx(np.linalg.cond(block), rel=1e-6)
        assert found["sigma_i (1/kg)"][i] == pytest.approx(np.trace(block) / 3)
        coupling = problem.mu[i] * np.linalg.norm(block[1:, 0]) / block[0, 0]
        assert found["mu |W_TN| / W_NN"][i] == pytest.approx(coupling)


@pytest.mark.parametrize("facets", [0, 4])
def test_the_residual_is_shared_out_by_the_natural_map(facets):
    problem = oracles.strands(0).condense()
    r = np.random.default_rng(1).normal(size=3 * problem.n)
    u = (problem.W @ r + problem.b).reshape(-1, 3)
    squares = [
        np.sum(oracles.natural_map(u[i], r[3 * i : 3 * i + 3], problem.mu[i], problem.sigma[i], facets) ** 2)
        for i in range(problem.n)
    ]
    np.testing.assert_allclose(residual_by_contact(problem, r, facets), squares / np.sum(squares), rtol=1e-7)
    alone = IncrementalProblem.from_sparse(np.eye(3), np.array([1.0, 0, 0]), np.array([0.5]))
    assert residual_by_contact(alone, np.zeros(3), facets).tolist() == [0.0]


# Local solves that fail where it is known


@jit
def fails_on_rough(W, b, mu, r, options):
    """Leave contacts with mu above options[0] as they are; the others solved without friction."""
    if mu > options[0]:
        return 2, r, 3
    return 0, (max(0.0, -b[0] / W[0][0]), 0.0, 0.0), 1


@jit
def never_fails_on_rough(W, b, mu, r, options):
    """The whole solver of which the other is what it tries first."""
    return 0, (max(0.0, -b[0] / W[0][0]), 0.0, 0.0), 4 if mu > options[0] else 1


def made_up_solver(kernel, first=None):
    entry = SimpleNamespace(
        solver=LocalSolver(kernel, first=first), origin="here", fingerprint="", name="made-up"
    )
    return Configured("made-up", entry, np.array([0.5]), 0)


ROUGH = [1, 4]


@cache
def rough():
    """Independent contacts pressed down and aside, two of them rough."""
    mu = np.where(np.isin(np.arange(8), ROUGH), 0.9, 0.1)
    b = np.tile([-1.0, 0.01, 0.0], 8)
    return IncrementalProblem.from_sparse(np.eye(24) * 2.0, b, mu)


def run_on_rough(solver, sweeps=20):
    laid = lay_out(rough())
    loop = GaussSeidel(solver, tolerance=1e-9, max_sweeps=sweeps, **LOOPS["plain"])
    about = ABOUT | {"solver": "made-up", "max_sweeps": sweeps}
    return laid, *logged(loop, laid, None, about)


def test_known_failing_contacts_are_found():
    solver = made_up_solver(fails_on_rough)
    laid, run, _, record = run_on_rough(solver)
    found = failures_of(record, solver, local("secular"))
    assert found.by_status == {Status.STALLED: 2 * 20}
    assert found.total == run.visits.failures == 40
    assert found.visits == 160
    assert np.flatnonzero(found.by_contact).tolist() == ROUGH
    assert sorted(found.holders.tolist()) == ROUGH
    assert (found.sampled, found.solvable, found.empty, found.restarted) == (40, 40, 40, 0)
    assert found.secular_left < 1e-12
    assert found.left == pytest.approx(1.0, rel=0.01)  # nothing was done about b
    facts = examine(record, laid, solver, local("secular"))
    assert sorted(facts.holders.tolist()) == ROUGH
    assert facts.motion.kind == "still"
    text = dict(words(facts))
    assert "40 of 160 failed (25 %): the line search found no decrease (40)." in text["local solves"]
    assert "100 % sit on 2 of 8 contacts (1, 4)." in text["local solves"]
    assert "Contact 1: mu 0.9. Contact 4: mu 0.9." in text["local solves"]
    assert "Of 40 sampled ones secular solves 40" in text["local solves"]
    assert "In 40 the contact was left with less than 1 % of the impulse it needs." in text["local solves"]
    assert "the run stands still" in text["impulses"]


def test_the_use_of_a_fall_back_is_counted_by_asking_again():
    solver = made_up_solver(never_fails_on_rough, first=fails_on_rough)
    _, _, _, record = run_on_rough(solver)
    found = fallback_of(record, solver)
    assert (found.sampled, found.used, found.exact) == (160, 40, True)
    assert fallback_of(record, made_up_solver(never_fails_on_rough)) is None
    _, _, _, longer = run_on_rough(solver, sweeps=1000)  # 8000 visits, of which 1000 are sampled
    sampled = fallback_of(longer, solver)
    assert (sampled.sampled, sampled.exact) == (1000, False)
    assert abs(sampled.used / 1000 - 0.25) < 3 * np.sqrt(0.25 * 0.75 / 1000)


def test_failures_by_another_law_are_not_solved_by_coulombs():
    found = failures_of(run_on_rough(made_up_solver(fails_on_rough))[3], local("pyramid"), local("secular"))
    assert (found.total, found.sampled) == (40, 0)
    assert math.isnan(found.left)


# Words and figure


def facts_of(record, tried=()):
    laid = lay_out(oracles.strands(0, contacts=6).condense())
    return examine(record, laid, local("secular"), local("secular"), tried)


def attempt(solver, outer, sweeps, solved=True, residual=1e-5):
    return Attempt(solver, outer, 0, solved, sweeps, residual, np.geomspace(1, residual, sweeps + 1))


def say(**about):
    return dict(words(facts_of(record(about=ABOUT | about))))


def test_the_verdict_is_that_of_the_table():
    solved = say(solved=True, residual=9.1e-5)["verdict"]
    assert solved == "Solved after 50 sweeps: the residual is 9.1e-05, the tolerance 1e-04."
    assert say()["verdict"].endswith("the tolerance 1e-04, although every local solve succeeded.")
    assert "and local solves failed." in say(reason="local")["verdict"]
    assert "the time was exhausted" in say(reason="time")["verdict"]
    assert "made-up (6 contacts), secular at mid" in title(facts_of(record()))


def test_the_rate_is_said_with_what_it_leads_to():
    text = say()["residual"]
    further = math.log(0.9**50 / 1e-4) / -math.log(0.9)
    assert (
        f"It fell by a factor 0.90 a sweep over sweeps 25 to 50; going on so, it would take {further:.2g}"
        in text
    )
    assert "would take" not in say(solved=True)["residual"]
    assert "a proximal term is in force since sweep 30" in say(proximal_from=30)["residual"]
    rising = record(residual=np.maximum(0.9 ** np.arange(51), 0.02) * np.where(np.arange(51) > 45, 3, 1))
    assert "the last one is 6.0e-02" in dict(words(facts_of(rising)))["verdict"]


def test_cycles_and_drifts_are_said():
    k = np.arange(RECENT, dtype=float)
    x = np.zeros((RECENT, 6, 3))
    x[:, 2, 1] = k % 5
    text = dict(words(facts_of(record(recent=x))))["impulses"]
    assert (
        "The impulses cycle with period 5 over the last 64 sweeps; 1 contact moved by more than 1e-06 b,"
        in text
    )
    assert "on 1 of 6 contacts (2). Periods of single contacts: 5 (1)." in text
    x[:, 2, 1] = 0.0
    x[:, 3, 0] = 100.0 - k
    text = dict(words(facts_of(record(recent=x))))["impulses"]
    assert "The impulses drift along a straight line (way over path 1.00)" in text
    assert "Going on so, contact 3 opens in 37 sweeps." in text
    growing = record(size=np.linspace(0, 40.0, 51))
    assert (
        "is 40 b, 2 times that of half-way (like sweeps^1): above 10 b"
        in dict(words(facts_of(growing)))["impulses"]
    )


@pytest.mark.parametrize(
    ("tried", "said"),
    [
        (
            [attempt("hybrid", "plain", 30)],
            "hybrid by the plain outer loop: 30 sweeps. Another local solver is enough;",
        ),
        ([attempt("secular", "accelerated", 20)], "The other outer loop is enough, by itself."),
        (
            [attempt("hybrid", "plain", 30), attempt("secular", "accelerated", 20)],
            "secular by the accelerated outer loop: 20 sweeps. Another local solver is enough, and so is the other",
        ),
        ([attempt("hybrid", "accelerated", 20)], "It takes another local solver and the other outer loop."),
        ([attempt("hybrid", "plain", 50, False, 3e-3)], "least residual is 3.0e-03, of hybrid by the plain"),
    ],
)
def test_advice_is_what_other_runs_showed(tried, said):
    assert said in dict(words(facts_of(record(), tried)))["what to try"]


def test_a_solved_run_is_told_of_clearly_faster_ones_only():
    solved = record(about=ABOUT | {"solved": True})
    assert (
        "Nothing that was tried"
        in dict(words(facts_of(solved, [attempt("hybrid", "plain", 45)])))["what to try"]
    )
    assert "30 sweeps" in dict(words(facts_of(solved, [attempt("hybrid", "plain", 30)])))["what to try"]
    assert "what to try" not in dict(words(facts_of(solved)))


def facts_of_a_cycle():
    x = np.zeros((RECENT, 6, 3))
    x[:, 2, 1], x[:, 3, 1] = np.arange(RECENT) % 5, np.arange(RECENT) % 2
    return facts_of(record(recent=x), [attempt("hybrid", "plain", 30)])


def facts_of_a_drift():
    x = np.zeros((RECENT, 6, 3))
    x[:, 3, 0] = 100.0 - np.arange(RECENT)
    return facts_of(record(recent=x, about=ABOUT | {"proximal_from": 20}))


def facts_of_failures(sweeps=300):
    solver = made_up_solver(fails_on_rough)
    return examine(run_on_rough(solver, sweeps)[3], lay_out(rough()), solver, local("secular"))


def facts_of_nothing():
    laid = lay_out(oracles.strands(0, contacts=0).condense())
    record = logged(GaussSeidel(local("secular"), **LOOPS["plain"]), laid, None, ABOUT)[2]
    return examine(record, laid, local("secular"), local("secular"))


@pytest.mark.parametrize("make", [facts_of_a_cycle, facts_of_a_drift, facts_of_failures, facts_of_nothing])
def test_every_kind_of_run_is_said_and_drawn(make):
    facts = make()
    assert all(text and "nan" not in text for _, text in words(facts))
    figure = draw(facts)
    figure.draw_without_rendering()
    titles = [axes.get_title() for axes in figure.axes]
    assert [word in title for word, title in zip(("residual", "regimes"), titles, strict=False)] == [
        True,
        True,
    ]
    assert all(axes.get_xlabel() and axes.get_ylabel() for axes in figure.axes[:4])


def test_other_runs_keep_the_limits_and_the_tolerance():
    laid = lay_out(oracles.strands(1, rods=4, dofs=6, contacts=24, mu=0.5, spread=1e4).condense())
    others = [(local("secular"), "plain"), (local("pyramid"), "accelerated")]
    plain, accelerated = attempts(laid, None, ABOUT | {"max_sweeps": 15, "tolerance": 1e-9}, others)
    assert (plain.solver, plain.outer, plain.facets, plain.sweeps, plain.solved) == (
        "secular",
        "plain",
        0,
        15,
        False,
    )
    assert len(plain.history) == 16
    assert plain.residual == pytest.approx(np.nanmin(plain.history))
    assert (accelerated.solver, accelerated.outer, accelerated.facets) == ("pyramid", "accelerated", 4)


# The command line


def stack(contacts=4, mu=0.4):
    """Unit masses one on another, pushed down and aside; the lowest on the ground."""
    H = csr_array(np.kron((eye_array(contacts) - eye_array(contacts, k=-1)).toarray(), np.eye(3)))
    f = np.tile([1.0, 0.1, -0.2], contacts)
    return StepProblem(
        eye_array(3 * contacts, format="csr"), f, H, np.zeros(3 * contacts), np.full(contacts, mu)
    )


@pytest.fixture
def file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "stack.hdf5", stack())
    write(tmp_path / "other.hdf5", stack(3))
    return tmp_path / "stack.hdf5"


def call(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def test_explain_says_and_draws_the_same_from_the_run_and_from_its_log(file, tmp_path):
    ran = call("explain", "stack.hdf5", "mfb", "--accuracy", "high", "--out", "here")
    assert ran.exit_code == 0, ran.stderr
    lines = ran.stdout.splitlines()
    assert lines[0].startswith(
        "stack (4 contacts), mfb at high (residual 1e-06 relative to b), plain outer loop"
    )
    assert lines[1].startswith("verdict       Solved after ")
    for other in (
        "secular, plain outer loop",
        "mfb, accelerated outer loop",
        "secular, accelerated outer loop",
    ):
        assert other in " ".join(ran.stdout.split())
    assert lines[-1] == "figure        here/stack.mfb.high.png"
    assert (tmp_path / "here" / "stack.mfb.high.svg").stat().st_size > 0

    call("solve", "stack.hdf5", "--solver", "mfb", "--accuracy", "high", "--log-file", "log.hdf5")
    again = call("explain", "stack.hdf5", "mfb", "--log", "log.hdf5", "--out", "here")
    assert again.exit_code == 0, again.stderr
    assert again.stdout == ran.stdout


def test_explain_takes_plugins_and_limits(file, tmp_path):
    (tmp_path / "lazy.py").write_text(PLUGIN)
    result = call("explain", "stack.hdf5", "lazy", "--plugin", "lazy.py", "--max-sweeps", 90, "--out", "here")
    assert result.exit_code == 0, result.stderr
    text = " ".join(result.stdout.split())
    assert "Not solved: after 90 sweeps" in text
    assert "360 of 360 failed (100 %): no admissible root was found (360)." in text
    assert "Another local solver is enough; the other outer loop alone is not." in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere", "pac"], "no problem 'nowhere': no file, nor in "),
        (["stack.hdf5", "nix"], "unknown local solver 'nix' (known: dac"),
        (["stack.hdf5", "pac:nix=1"], "unknown option 'nix'"),
        (
            ["stack.hdf5", "pac", "--accuracy", "best"],
            "unknown accuracy 'best' (known: low, mid, high, full)",
        ),
        (["stack.hdf5", "pac", "--outer", "fast"], "unknown outer loop 'fast'"),
        (["stack.hdf5", "pac", "--start", "guess"], "no guess"),
        (["stack.hdf5", "pac", "--plugin", "nowhere.py"], "nowhere.py: no such file"),
        (["stack.hdf5", "pac", "--log", "nowhere.hdf5"], "nowhere.hdf5: no such file"),
        (["stack.hdf5", "pac", "--log", "stack.hdf5"], "stack.hdf5: not a visit log"),
        (["stack.hdf5", "pac", "--log", "log.hdf5"], "log.hdf5: is about stack by mfb, not stack by pac"),
        (["other.hdf5", "mfb", "--log", "log.hdf5"], "log.hdf5: is about stack by mfb, not other by mfb"),
        (["stack.hdf5", "mfb", "--log", "log.hdf5", "--accuracy", "low"], "--accuracy beside --log"),
        (["stack.hdf5", "mfb", "--log", "log.hdf5", "--max-sweeps", "7"], "--max-sweeps beside --log"),
        (["stack.hdf5", "pac", "--max-sweeps", "2000000"], "at most 1000000 sweeps"),
        (["stack.hdf5", "pac", "--out", "stack.hdf5"], "stack.hdf5"),
    ],
)
def test_errors_of_explain_take_one_line(file, arguments, message):
    if "log.hdf5" in arguments:
        call("solve", "stack.hdf5", "--solver", "mfb", "--log-file", "log.hdf5")
    result = call("explain", *arguments)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr.count("\n") == 1
    assert result.stderr.startswith("error: ")
    assert message in result.stderr


def test_problems_by_name(tmp_path, monkeypatch):
    """In any set that is at hand, here two of the current folder; of one in both, either has the same bytes."""
    monkeypatch.chdir(tmp_path)
    for folder, sizes in (("mine", (1, 2)), ("yours", (2, 3))):
        (tmp_path / "problems" / folder).mkdir(parents=True)
        for n in sizes:
            write(tmp_path / "problems" / folder / f"stack-{n}.hdf5", stack(n))
    places = [find_problem(f"stack-{n}").file.resolve().parent.name for n in (1, 2, 3)]
    assert places == ["mine", "mine", "yours"]
    assert find_problem("problems/mine/stack-1.hdf5").hash == find_problem("stack-1").hash
    said = r"'stack-9': no file, nor in .*problems/mine, problems/yours \(nearest: stack-"
    with pytest.raises(BenchError, match=said):
        find_problem("stack-9")


def test_outside_a_clone_problems_are_found_in_the_package(tmp_path, monkeypatch):
    """An installed package holds one set; without any, that is what is said."""
    package, away = tmp_path / "site-packages" / "fibercontact", tmp_path / "away"
    away.mkdir()
    monkeypatch.chdir(away)
    monkeypatch.setattr(problem_set, "__file__", str(package / "bench" / "problem_set.py"))
    with pytest.raises(BenchError, match="'stack-1': no file, and no set of problems is here"):
        find_problem("stack-1")
    (package / "data" / "sample").mkdir(parents=True)
    write(package / "data" / "sample" / "stack-1.hdf5", stack(1))
    assert find_problem("stack-1").file.parent == package / "data" / "sample"
    with pytest.raises(
        BenchError, match=rf"'nix': no file, nor in {package}/data/sample \(nearest: stack-1\)"
    ):
        find_problem("nix")


# The page that explains it


PAGE = Path(__file__).parents[1] / "docs" / "explain.md"


def test_the_page_speaks_of_what_there_is():
    text = PAGE.read_text(encoding="utf-8")
    for link in re.findall(r"\]\((?!http)([^)]+)\)", text):
        assert (PAGE.parent / link).is_file(), link
    commands = set(re.findall(r"^fibercontact (\w+) ", text, flags=re.MULTILINE))
    assert commands <= {registered.name for registered in app.registered_commands}
    assert all(f"`{name}`" in text for name in visits.SHAPES)
    thresholds = [
        f"above {explain.STALLED:g} of", f"hold {100 * explain.HELD:g} %", f"p ≤ {explain.LONGEST_PERIOD}",
        f"{100 * explain.TELLS:g} % of the pairs", f"{explain.CERTAIN:g} standard deviations",
        f"less than {100 * explain.EMPTY:g} % of", f"least {explain.STRAIGHT:g} of their path",
        f"above {explain.LARGE:g} b", f"{explain.GROWING:g} times", f"last {RECENT} sweeps",
        f"more than {visits.ROWS} sweeps", f"at most {visits.SAMPLE} visits", f"the {visits.MOVING} contacts",
        f"{visits.FIXED_BYTES / 1e6:g} MB and {visits.PER_CONTACT_BYTES} bytes",
    ]  # fmt: skip
    assert [said for said in thresholds if said not in text] == []
