"""One solver on one problem: what a worker process does, one request at a time.

A *pass* is one solve. The first pass is not timed and looks at the residual after every sweep; the timed
ones run as a user would run them. Every answer is measured here, from `(W, b, mu, r)` alone: what the solver
says of itself is recorded beside it and decides nothing.
"""

import copy
import dataclasses
import tempfile
import time
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from fibercontact.bench.protocol import ACCURACIES, OUTERS, BenchError, Limits
from fibercontact.bench.visits import SAMPLE, VisitRecord, record_of, write_log
from fibercontact.gauss_seidel.blocks import BlockSystem, block_system
from fibercontact.gauss_seidel.solver import LOOPS, GaussSeidel, Outcome, Run, Visits
from fibercontact.gauss_seidel.visit_log import new_log
from fibercontact.global_methods.contract import Answer, Task, Unsuited
from fibercontact.global_methods.registry import AnyConfigured, ConfiguredMethod
from fibercontact.local.contract import Status
from fibercontact.local.registry import Configured
from fibercontact.peers.registry import configure, registered
from fibercontact.problem.fclib import FclibFile, read, write
from fibercontact.problem.incremental import IncrementalProblem, ProblemWarning
from fibercontact.problem.measure import Measure, measure
from fibercontact.problem.step import StepProblem

__all__ = [
    "Desk", "Laid", "LogOrder", "Pass", "gauss_seidel", "judge", "lay_out", "logged", "options_text",
    "solve_globally", "starting_impulse",
]  # fmt: skip

Array = NDArray[np.float64]

UNSUITED = "unsuited"
"""Reason of a row whose method does not take the problem."""


class Laid(NamedTuple):
    """A problem ready for passes, and the seconds that this took."""

    problem: IncrementalProblem
    system: BlockSystem
    setup_seconds: float


class LogOrder(NamedTuple):
    """Where the visits of a pass are written, and what is known of it before."""

    file: Path
    about: Mapping[str, Any]


class Pass(NamedTuple):
    """What to do with the problem at hand; `solver` is the specification of a local solver or a global method."""

    solver: str
    accuracy: str
    outer: str
    limits: Limits
    timed: bool
    log: LogOrder | None = None


def gauss_seidel(local: Configured, tolerance: float, outer: str, limits: Limits) -> GaussSeidel:
    """The outer loop by its name, one of `LOOPS`."""
    return GaussSeidel(local, tolerance, limits.sweeps, limits.seconds, **LOOPS[outer])


def lay_out(problem: IncrementalProblem | StepProblem) -> Laid:
    """Condense a problem and lay it out for sweeps, on the clock (factorisation included)."""
    step = dataclasses.replace(problem) if isinstance(problem, StepProblem) else None
    began = time.perf_counter()
    incremental = step.condense() if step is not None else problem
    assert isinstance(incremental, IncrementalProblem)
    system = block_system(incremental)
    return Laid(incremental, system, time.perf_counter() - began)


def logged(
    loop: GaussSeidel, laid: Laid, start: Array | None, about: Mapping[str, Any]
) -> tuple[Run, Measure, VisitRecord]:
    """Solve with the residual looked at after every sweep and every visit recorded; measure and judge."""
    problem = laid.problem
    log = new_log(problem.n, loop.max_sweeps, SAMPLE)
    every = dataclasses.replace(loop, check_every=1)
    run = every.solve_system(laid.system, problem.b_ref, start, history=True, log=log)
    found = measure(problem, run.r, loop.local.facets)
    verdict = judge(run, found, loop.tolerance) | {"residual": found.residual}
    return run, found, record_of(log, run, problem.sigma, problem.b_ref, {**about, **verdict})


def solve_globally(
    method: ConfiguredMethod, laid: Laid, start: Array | None, tolerance: float, limits: Limits
) -> dict[str, Any]:
    """Solve by a global method, in a copy of the problem, and measure: what a pass leaves in its row, and `r`."""
    problem, system = laid.problem, copy.deepcopy(laid.system)
    began_at = None if start is None else start.copy()
    task = Task(tolerance, problem.b_ref, limits.sweeps, limits.seconds, began_at)
    began = time.perf_counter()
    try:
        answer = method.solve(system, task)
    except Unsuited as fault:
        verdict = {"claimed": False, "solved": False, "false_success": False}
        return verdict | {"outcome": UNSUITED, "reason": UNSUITED, "detail": str(fault)}
    seconds = time.perf_counter() - began
    found = measure(problem, answer.r, method.facets)
    solved = found.residual <= tolerance
    reason = "" if solved else _ending(answer, task, seconds)
    return {
        "r": answer.r,
        "seconds": seconds if answer.seconds is None else answer.seconds,
        "claimed": answer.claimed,
        "solved": solved,
        "false_success": answer.claimed and not solved,
        "reason": reason,
        "detail": "" if solved else answer.note,
        "outcome": "converged" if answer.claimed else reason or "not claimed",
        "sweeps": answer.iterations,
        "own_residual": answer.residual,
        **dataclasses.asdict(found),
    }


def _ending(answer: Answer, task: Task, seconds: float) -> str:
    """Why an answer that is none was given."""
    if not np.isfinite(answer.r).all():
        return "not finite"
    if answer.claimed:
        return "false success"
    if seconds >= task.max_seconds:
        return "time"
    return "iterations" if answer.iterations >= task.max_iterations else "stalled"


def starting_impulse(file: FclibFile, start: str) -> Array | None:
    """The impulse to start from; raises `BenchError` when the file holds no guess and one is asked for."""
    if start == "cold":
        return None
    for guess in file.guesses:
        if guess.r is not None:
            return guess.r
    raise BenchError(f"{file.path}: no guess of the impulses in it, so no start from one")


def options_text(solver: AnyConfigured) -> str:
    """All options of a configured solver with their values, `name=value` separated by commas."""
    names = solver.registered.solver.options
    return ",".join(f"{name}={float(value)!r}" for name, value in zip(names, solver.options, strict=True))


def judge(run: Run, found: Measure, tolerance: float) -> dict[str, Any]:
    """The verdict on a run: solved by the harness's measure, claimed by the solver's, the reason if not."""
    solved = found.residual <= tolerance
    return {
        "claimed": run.claimed,
        "solved": solved,
        "false_success": run.claimed and not solved,
        "reason": "" if solved else _reason(run),
        "detail": "" if solved else _detail(run.visits),
    }


def _reason(run: Run) -> str:
    if run.outcome == Outcome.SWEEPS:
        return "local" if run.visits.failures else "outer"
    return {
        Outcome.CONVERGED: "false success",
        Outcome.TIME: "time",
        Outcome.NOT_FINITE: "not finite",
    }[run.outcome]


def _detail(visits: Visits) -> str:
    """How the local solves failed, by status."""
    failed = [(count, status) for status, count in visits.by_status.items() if status != Status.CONVERGED]
    return ", ".join(
        f"{status.name.lower()} {count}" for count, status in sorted(failed, reverse=True) if count
    )


class Desk:
    """The solvers of a table, compiled, and the problem at hand."""

    def __init__(self, plugins: Sequence[Path], solvers: Sequence[str]) -> None:
        known = registered(plugins)
        self._solvers = {label: configure(label, known) for label in solvers}
        self._laid: Laid | None = None
        self._start: Array | None = None
        for solver in self._solvers.values():  # compiled but not run: a stranger's may hang
            solver.kernel() if isinstance(solver, Configured) else solver.prepare()
        _warm_up(configure("secular", known))

    def fingerprints(self) -> dict[str, str]:
        """What the solvers were compiled from."""
        return {label: solver.registered.fingerprint for label, solver in self._solvers.items()}

    def load(self, path: Path, start: str) -> dict[str, Any]:
        """Take a problem from its file; returns its sizes, the seconds of its set-up, how it was altered."""
        with warnings.catch_warnings(record=True) as altered:
            warnings.simplefilter("always", ProblemWarning)
            file = read(path)
        self._start = starting_impulse(file, start)
        self._laid = lay_out(file.problem)
        problem = self._laid.problem
        return {
            "contacts": problem.n,
            "dofs": getattr(file.problem, "d", None),
            "mu_min": float(problem.mu.min()) if problem.n else None,
            "mu_max": float(problem.mu.max()) if problem.n else None,
            "blocks": len(problem.W.indices),
            "setup_seconds": self._laid.setup_seconds,
            "warning": "; ".join(str(warning.message).removeprefix(f"{path}: ") for warning in altered),
        }

    def solve(self, task: Pass) -> dict[str, Any]:
        """One pass over the problem at hand; a log that cannot be written is told in `log_fault`."""
        assert self._laid is not None, "no problem loaded"
        local, tolerance = self._solvers[task.solver], ACCURACIES[task.accuracy]
        if isinstance(local, ConfiguredMethod):
            row = solve_globally(local, self._laid, self._start, tolerance, task.limits)
            return {name: value for name, value in row.items() if name != "r"}
        loop = gauss_seidel(local, tolerance, task.outer, task.limits)
        if task.log is not None:
            run, found, record = logged(loop, self._laid, self._start, task.log.about)
            return judge(run, found, tolerance) | _account(run, found) | _written(task.log.file, record)
        if not task.timed:
            loop = dataclasses.replace(loop, check_every=1)
        problem = self._laid.problem
        began = time.perf_counter()
        run = loop.solve_system(self._laid.system, problem.b_ref, self._start)
        seconds = time.perf_counter() - began
        found = measure(problem, run.r, local.facets)
        return {"seconds": seconds} | judge(run, found, tolerance) | _account(run, found)


def _written(file: Path, record: VisitRecord) -> dict[str, str]:
    """Write a log; a full disk is no fault of the solver's."""
    try:
        write_log(file, record)
    except OSError as fault:
        return {"log_fault": f"{file}: {fault}"}
    return {}


def _warm_up(local: AnyConfigured) -> None:
    """Run everything that a pass runs once, from the file on, before any clock starts."""
    assert isinstance(local, Configured)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "one_contact.hdf5")
        write(file, _one_contact())
        laid = lay_out(read(file).problem)
    for outer in OUTERS:
        run = gauss_seidel(local, 1e-12, outer, Limits(9, 1.0)).solve_system(laid.system, laid.problem.b_ref)
        measure(laid.problem, run.r, local.facets)


def _account(run: Run, found: Measure) -> dict[str, Any]:
    """What a pass leaves in its row beside the verdict."""
    visits = run.visits
    return {
        "outcome": run.outcome.name.lower(),
        "sweeps": run.sweeps,
        "rescue": run.rescue,
        "visits_open": visits.open,
        "visits_stick": visits.stick,
        "visits_slip": visits.slip,
        "local_failures": visits.failures,
        "local_status": {status.name.lower(): count for status, count in visits.by_status.items() if count},
        "local_iterations": visits.iterations,
        **dataclasses.asdict(found),
    }


def _one_contact() -> StepProblem:
    """A unit mass on a plane, pushed down and aside."""
    return StepProblem(
        csr_array(np.eye(3)),
        np.array([1.0, -0.5, 0.0]),
        csr_array(np.eye(3)),
        np.zeros(3),
        np.array([0.3]),
    )
