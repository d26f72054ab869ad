"""The contract's checks: every built-in solver keeps it, each way of breaking it is seen by the check that should."""

import textwrap

import numba
import numpy as np
import oracles
import pytest
from typer.testing import CliRunner

from fibercontact.bench.conformance.apart import examine_apart
from fibercontact.bench.conformance.card import headline, markdown
from fibercontact.bench.conformance.contacts import (
    FRICTIONLESS,
    PAGE,
    SLIP,
    STICK,
    TAKE_OFF,
    from_page,
    kind,
    numbers,
    ordinary,
    posed,
)
from fibercontact.bench.conformance.reports import REPORTS
from fibercontact.bench.conformance.required import REQUIRED
from fibercontact.bench.conformance.suite import CHECKS, Outcome, Verdict, asks, examine, holds
from fibercontact.cli import app
from fibercontact.local.contract import Status
from fibercontact.local.registry import configure, registered

compiled = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="the compiled loop is what is tested")

PLUGIN = '''"""A solver for a test: secular, and a fault."""
import math
import os
import numba
import numpy as np
from fibercontact.jit import jit
from fibercontact.local.algebra import is_finite
from fibercontact.local.contract import LocalSolver, Option, Status
from fibercontact.local.methods.secular import kernel as secular, solver as base

@{decorator}
def kernel(W, b, mu, r, options):
    status, x, k = secular(W, b, mu, r, options)
    small, large = min(W[0][0], W[1][1], W[2][2]), max(W[0][0], W[1][1], W[2][2])
    {fault}
    return {answer}

solver = LocalSolver(kernel, options=dict(base.options){declaration})
'''


def plugin(folder, fault="", answer="status, x, k", declaration="", decorator="jit"):
    path = folder / "my_solver.py"
    body = textwrap.indent(textwrap.dedent(fault).strip(), "    ").strip()
    path.write_text(PLUGIN.format(fault=body, answer=answer, declaration=declaration, decorator=decorator))
    return path


def broken(local, checks=REQUIRED):
    """The checks that fail, with their verdicts."""
    verdicts = [examine(local, check) for check in checks]
    return {v.check: v for v in verdicts if v.outcome == Outcome.FAIL}


# The built-in solvers

BUILT_IN = [*sorted(registered()), "pyramid:facets=3", "pyramid:facets=16", "pac:disc=1", "dac:rho=3"]


@pytest.mark.parametrize("name", BUILT_IN)
def test_built_in_solvers_keep_the_contract(name):
    assert broken(configure(name, registered())) == {}


@compiled
@pytest.mark.parametrize("name", ["secular", "pyramid"])
def test_reports_say_what_a_good_solver_is_worth(name):
    found = {check: examine(configure(name, registered()), check) for check in REPORTS}
    assert {verdict.outcome for verdict in found.values()} == {Outcome.REPORTED}
    missed = {family: float(percent) for family, _, percent, _ in found["hard contacts"].table.rows}
    assert missed["double root"] == 0.0
    assert missed["impulse along the weak axis"] > 1.0
    problems = found["whole problems"].table.rows
    assert found["whole problems"].sentence == f"{len(problems)} of {len(problems)} solved"
    times = [float(row[1]) for row in found["speed"].table.rows]
    assert [row[0] for row in found["speed"].table.rows] == [name, "secular", "hybrid"]
    assert min(times) > 0


# The gallery of faults

UNCLAIMED = "if r[0] > 0.0: status = Status.ITERATIONS"
TILTED = "if x[1] > 0.0 and abs(x[2]) < 0.1 * x[1]: status = Status.STALLED"
LAST_BIT = "x = (x[0] * (1.0 + 3e-16 * np.random.random()), x[1], x[2])"

FAULTS = {
    "none": ("", set()),
    "friction along the motion": (
        "x = (x[0], -x[1], -x[2])", {"stick", "slip", "honest", "fixed point", "not finite"}
    ),
    "outside the cone": (
        "x = (x[0], 1.01 * x[1], 1.01 * x[2])", {"stick", "slip", "cone", "honest", "fixed point", "not finite"}
    ),
    "holds what parts": (
        "if b[0] > 0.0: x = (0.01 * b[0] / large, 0.0, 0.0)",
        {"take off", "frictionless", "honest", "fixed point", "not finite"},
    ),
    "friction where there is none": (
        "if mu == 0.0 and b[0] < 0.0: x = (x[0], -0.01 * b[1] / large, 0.0)",
        {"frictionless", "honest", "fixed point", "not finite"},
    ),
    "false claims at ill-conditioned contacts": (
        "if large > 30 * small: x = (1.1 * x[0], 1.1 * x[1], 1.1 * x[2])",
        {"honest"},
    ),
    "gives up on slip": (
        "if k > 0 and x[1] ** 2 + x[2] ** 2 > 0.25: status = Status.STALLED", {"slip", "scaling", "fixed point"}
    ),
    "an absolute tolerance": ("if abs(b[0]) < 1e-6: x = (0.0, 0.0, 0.0)", {"honest", "scaling"}),
    "a preferred direction": (TILTED, {"rotation"}),
    "not solved from a start": (UNCLAIMED, {"fixed point"}),
    "random numbers": (LAST_BIT, {"deterministic"}),
    "options written": ("options[1] += 1.0", {"options kept"}),
    "claims on NaN": (
        "if not is_finite(W, b, mu): x, status = (0.0, 0.0, 0.0), Status.CONVERGED", {"not finite"}
    ),
    "passes NaN on from the start": (
        "if not math.isfinite(r[1]): x = (x[0], r[1], x[2])", {"not finite"}
    ),
    "raises on NaN": ("if not is_finite(W, b, mu): raise ValueError('NaN')", {"not finite"}),
    "raises": ("if large > 30 * small: raise ValueError('too hard')",
               {"returns", "cone", "honest", "deterministic", "options kept", "not finite"}),
    "counts below zero": ("k = -1", {"returns"}),
    "an unknown status": ("if large > 30 * small: status = 42", {"returns"}),
    "converges to NaN": (
        "if large > 30 * small and k > 0: x, status = (math.nan, x[1], x[2]), Status.CONVERGED",
        {"returns", "cone", "honest"},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_seen_by_the_checks_that_should(tmp_path, name):
    fault, expected = FAULTS[name]
    found = broken(configure("my-solver", registered([plugin(tmp_path, fault)])))
    assert set(found) == expected
    assert all(verdict.sentence and verdict.detail for verdict in found.values())


def test_the_faults_make_every_check_fail():
    seen = set().union(*(expected for _, expected in FAULTS.values()))
    assert seen == set(REQUIRED) - {"declared", "compiles", "several"}  # which have tests below


@compiled
@pytest.mark.parametrize(
    ("fault", "kept"), [("", True), ("x = (x[0], x[1] * (1.0 + 3e-16), x[2])", False), ("k += 1", False)]
)
def test_several_contacts_at_once_have_the_kernels_bits(tmp_path, fault, kept):
    local = configure(
        "my-solver", registered([plugin(tmp_path, fault, declaration=", several=base.several")])
    )
    verdict = examine(local, "several")
    assert verdict.outcome == (Outcome.PASS if kept else Outcome.FAIL)
    if not kept:
        assert "the kernel has" in verdict.sentence


@compiled
def test_a_kernel_for_several_contacts_that_does_not_compile_is_named(tmp_path):
    local = configure(
        "my-solver",
        registered([plugin(tmp_path, declaration=", several=jit(lambda W, b, mu, r, options: r)")]),
    )
    assert "does not compile" in examine(local, "several").sentence


STEP_FAULTS = {
    "none": ("", set()),
    "never arrives": ("x = (0.9 * x[0], 0.9 * x[1], 0.9 * x[2])", {"stick", "slip", "frictionless", "fixed point"}),
    "leaves the solution": ("if r[0] > 0.0: x = (0.0, 0.0, 0.0)", {"fixed point"}),
    "strays from the cone": ("if r[0] == 0.0: x = (x[0], 1.5 * x[1], 1.5 * x[2])", {"cone"}),
}  # fmt: skip


@pytest.mark.parametrize("name", STEP_FAULTS)
def test_a_fault_of_a_step_is_seen_by_the_checks_that_should(tmp_path, name):
    fault, expected = STEP_FAULTS[name]
    local = configure("my-solver", registered([plugin(tmp_path, fault, declaration=", exact=False")]))
    assert set(broken(local)) == expected
    assert examine(local, "honest").outcome == Outcome.NOT_ASKED


def test_a_solver_of_the_wrong_law_is_judged_by_the_law_that_it_declares(tmp_path):
    """Secular declared to be a pyramid's solver: right where the two laws agree, wrong on the edge and in slip."""
    local = configure("my-solver", registered([plugin(tmp_path, declaration=", facets=4")]))
    assert set(broken(local)) == {"stick", "slip", "honest", "cone", "not finite"}


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (('"""A solver for a test: secular, and a fault."""', ""), "no docstring"),
        (("dict(base.options)", '{"a": Option(1.0, "one"), "b": Option(9.0, " ")}'), "'b' has no meaning"),
    ],
)
def test_a_solver_must_say_what_it_is(tmp_path, change, reason):
    path = plugin(tmp_path)
    path.write_text(path.read_text().replace(*change))
    verdict = examine(configure("my-solver", registered([path])), "declared")
    assert verdict.outcome == Outcome.FAIL
    assert reason in verdict.sentence


@compiled
def test_a_kernel_must_compile_to_the_signature(tmp_path):
    path = plugin(tmp_path, answer="status, x")
    found = broken(configure("my-solver", registered([path])), ["declared", "compiles"])
    assert set(found) == {"compiles"}
    assert "does not compile to the signature" in found["compiles"].sentence


def test_the_counterexample_can_be_pasted(tmp_path):
    fault, _ = FAULTS["claims on NaN"]
    local = configure("my-solver", registered([plugin(tmp_path, fault)]))
    names = {}
    exec(examine(local, "not finite").detail, names)
    W, b, mu, r, options = (names[name] for name in ("W", "b", "mu", "r", "options"))
    assert not np.isfinite([*np.ravel(W), *b, mu]).all()
    assert local.kernel()(W, b, mu, r, np.array(options))[0] == Status.CONVERGED


# The contacts


def test_kind_contacts_have_one_solution_each():
    for W, b, mu, _ in kind():
        assert len(oracles.coulomb_solutions(W, b, mu)) == 1
        assert np.linalg.cond(W) < 4.1


@pytest.mark.parametrize(
    "cases", [TAKE_OFF, STICK, SLIP, FRICTIONLESS], ids=["open", "stick", "slip", "frictionless"]
)
def test_the_exact_answers_are_solutions(cases):
    count = 0
    for (W, b, mu, _), answer in posed(cases):
        assert oracles.local_residual(np.array(W), np.array(b), mu, np.array(answer)) <= 1e-15
        count += 1
    assert count == 3 * len(cases)


def test_the_ordinary_contacts_are_of_every_regime():
    counts = {"open": 0, "stick": 0, "slip": 0}
    local = configure("secular", registered())
    for contact in ordinary():
        _, r, k = local.kernel()(*contact, local.options)
        counts["open" if r[0] == 0.0 else "slip" if k else "stick"] += 1
    assert min(counts.values()) >= 10


def test_a_page_holds_a_contact():
    for contact in ordinary():
        page = np.array(numbers(contact))
        assert page.shape == (PAGE,)
        assert from_page(page) == contact


# The card


def verdicts(**outcomes):
    given = {name.replace("_", " "): outcome for name, outcome in outcomes.items()}
    return [Verdict(check, given.get(check, Outcome.PASS), "a | b") for check in CHECKS]


def test_the_contract_holds_when_nothing_failed_and_nothing_was_left_out():
    local = configure("secular", registered())
    good = verdicts(honest=Outcome.NOT_ASKED, speed=Outcome.REPORTED)
    assert holds(good)
    assert headline(local, good) == "secular: the contract holds"
    assert not holds(verdicts(speed=Outcome.NOT_RUN))
    bad = verdicts(scaling=Outcome.FAIL, not_finite=Outcome.FAIL)
    assert not holds(bad)
    assert headline(local, bad) == "secular: the contract is broken: scaling, not finite"


def test_the_card_has_a_line_a_check():
    card = markdown(configure("pyramid:facets=8", registered()), verdicts())
    assert card.startswith("# pyramid:facets=8: the contract holds\n")
    assert "* options: facets=8.0" in card
    for check in CHECKS:
        assert f"| {check} | pass | {asks(check)} | a \\| b |" in card


# In a process of its own


def call(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def outcomes(card):
    """Check by check, from the Markdown."""
    rows = [line.split(" | ") for line in card.read_text().splitlines() if line.startswith("| ")]
    return {row[0][2:]: row[1] for row in rows if row[0][2:] in CHECKS}


@compiled
def test_a_solver_that_dies_and_hangs_is_found_out(tmp_path):
    """Both inputs are named; two processes are lost, and what is left is not run."""
    fault = """
    if b == (-1.5, 0.85, 0.0) and r[0] == 0.0:
        options[10**15] = 1.0
    y = 0.0
    while y <= 1.0 and math.isnan(mu):
        y = 0.5 * (y + 1.0)
    """
    path = plugin(tmp_path, fault)
    local = configure("my-solver", registered([path]))
    found = {v.check: v for v in examine_apart(local, [path], 2.0, ["stick", "slip", "not finite", "cone"])}
    assert [v.outcome for v in found.values()] == ["pass", "FAIL", "FAIL", "not run"]
    assert found["slip"].sentence == "the process died of SIGSEGV"
    assert "b = (-1.5, 0.85, 0.0)\nmu = 0.5\n" in found["slip"].detail
    assert "no answer within 2 s" in found["not finite"].sentence
    assert "\nmu = nan\n" in found["not finite"].detail
    assert not holds(list(found.values()))


@compiled
def test_answers_that_differ_between_processes_are_found_out(tmp_path):
    path = plugin(tmp_path, "k += PID", decorator='numba.njit(error_model="numpy")')
    path.write_text(path.read_text().replace("@numba", "PID = os.getpid()\n\n\n@numba"))
    local = configure("my-solver", registered([path]))
    assert broken(local) == {}
    (verdict,) = examine_apart(local, [path], 20.0, ["deterministic"])
    assert verdict.outcome == Outcome.FAIL
    assert "in one process" in verdict.sentence
    assert verdict.detail


@compiled
def test_a_broken_contract_ends_with_exit_code_1(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = call("check", plugin(tmp_path, answer="status, x").name)
    assert result.exit_code == 1
    found = outcomes(tmp_path / "runs" / "check" / "my-solver.md")
    assert (found["declared"], found["compiles"]) == ("pass", "FAIL")
    assert {found[check] for check in [*CHECKS][2:]} == {"not run"}
    assert "No conversion from" in result.stdout
    assert "my-solver: the contract is broken: compiles (runs/check/my-solver.md)" in result.stdout


# A solver to start from


@compiled
def test_the_solver_to_start_from_passes(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = call("new-solver", "my-solver")
    assert result.exit_code == 0
    assert "fibercontact check my_solver.py" in result.stdout
    result = call("check", "my_solver.py:max_iterations=300", "--out", "cards/mine.md")
    assert result.exit_code == 0, result.output
    assert "my-solver:max_iterations=300: the contract holds (cards/mine.md)" in result.stdout
    found = outcomes(tmp_path / "cards" / "mine.md")
    assert list(found) == list(CHECKS)
    assert found.pop("several") == "not asked"
    assert set(found.values()) == {"pass", "reported"}


def test_the_solver_to_start_from_keeps_the_contract_and_fails_nowhere(tmp_path):
    path = tmp_path / "halving.py"
    assert call("new-solver", "halving", "--out", path).exit_code == 0
    local = configure("halving", registered([path]))
    assert broken(local) == {}
    rng = np.random.default_rng(0)
    for _ in range(100):
        W, b = oracles.definite(rng, 1e4), rng.standard_normal(3) * (-1, 1, 1)
        status, r, _ = local.kernel()(totuple(W), tuple(b.tolist()), 0.7, (0.0, 0.0, 0.0), local.options)
        assert status == Status.CONVERGED
        assert oracles.local_residual(W, b, 0.7, np.array(r)) <= 1e-8 * np.linalg.norm(b)


def totuple(W):
    return tuple(tuple(row) for row in W.tolist())


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("2fast", "'2fast' cannot name a Python module"),
        ("a b", "'a b' cannot name a Python module"),
        ("lambda", "'lambda' cannot name a Python module"),
        ("bisect", "'bisect' is a module of Python itself"),
        ("secular", "'secular' is a solver already"),
        ("enum_quartic", "'enum-quartic' is a solver already"),
    ],
)
def test_names_that_cannot_be(tmp_path, monkeypatch, name, message):
    monkeypatch.chdir(tmp_path)
    result = call("new-solver", name)
    assert result.exit_code == 2
    assert message in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_file_is_never_overwritten(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text("precious")
    result = call("new-solver", "mine")
    assert result.exit_code == 2
    assert "mine.py" in result.stderr
    assert (tmp_path / "mine.py").read_text() == "precious"


@pytest.mark.parametrize(
    ("solver", "message"),
    [
        ("nowhere.py", "nowhere.py: no such file"),
        ("nix", "unknown local solver 'nix' (known: dac,"),
        ("broken.py", "broken.py: SyntaxError"),
        ("pac:speed=1", "unknown option 'speed'"),
    ],
)
def test_errors_of_check(tmp_path, monkeypatch, solver, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken.py").write_text("def f(")
    result = call("check", solver)
    assert result.exit_code == 2
    assert message in result.stderr
    assert result.stderr.count("\n") == 1
    assert not (tmp_path / "runs").exists()
