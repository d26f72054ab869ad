"""The contract's checks on a solver that may hang or crash: in a process that is killed at a time limit."""

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fibercontact.bench.conformance.contacts import PAGE, from_page, ordinary
from fibercontact.bench.conformance.required import answers
from fibercontact.bench.conformance.subject import Subject
from fibercontact.bench.conformance.suite import CHECKS, Outcome, Verdict, examine, failed
from fibercontact.bench.worker import START_SECONDS, Crashed, Hung, Refused, Setting, Worker
from fibercontact.local.registry import Configured, configure, registered

__all__ = ["Desk", "examine_apart"]

LOST = 2
"""Processes that may be lost; the checks that are left are not run then."""

COMPILES, DETERMINISTIC = "compiles", "deterministic"


class Desk:
    """The solver under examination, in a process of its own."""

    def __init__(self, plugins: Sequence[Path], solvers: Sequence[str]) -> None:
        (label,) = solvers
        self._local = configure(label, registered(plugins))
        known = registered()
        for name in CHECKS:  # compiles what the checks call, before any clock runs
            examine(configure("secular", known), name)

    def fingerprints(self) -> dict[str, str]:
        """What the solver is made from."""
        return {self._local.label: self._local.registered.fingerprint}

    def check(self, name: str, page: Path) -> Verdict:
        """One check; the input of every visit is on the page before the kernel sees it."""
        return examine(self._local, name, np.memmap(page, np.float64, "r+", shape=PAGE))

    def answers(self) -> NDArray[np.float64]:
        """The answers that must be the same bits in every process."""
        return answers(Subject(self._local))


def examine_apart(
    local: Configured, plugins: Sequence[Path], seconds: float, checks: Sequence[str] = tuple(CHECKS)
) -> Iterator[Verdict]:
    """Run the checks, each of at most `seconds`; one verdict after the other, as they come.

    Raises `BenchError` when the plugins cannot be loaded in a new process.
    """
    with tempfile.TemporaryDirectory() as folder:
        examiner = _Examiner(local, plugins, seconds, Path(folder, "page"))
        try:
            for name in checks:
                yield examiner.verdict(name)
        finally:
            examiner.end()


class _Examiner:
    """Asks a worker check by check, and a second one whether it answers the same."""

    def __init__(self, local: Configured, plugins: Sequence[Path], seconds: float, page: Path) -> None:
        self._local, self._seconds, self._page = local, seconds, page
        setting = Setting(plugins, {local.label: local.registered.fingerprint}, desk=__name__)
        self._worker, self._second = Worker(setting), Worker(setting)
        self._lost = 0
        self._stopped = ""

    def verdict(self, name: str) -> Verdict:
        """Of one check, whatever becomes of the process."""
        if self._stopped:
            return Verdict(name, Outcome.NOT_RUN, self._stopped)
        self._page.write_bytes(bytes(8 * PAGE))
        try:
            found = self._ask(name)
        except Hung:
            found = self._lose(name, f"no answer within {self._seconds:g} s: it hangs, or is very slow")
        except Crashed as fault:
            found = self._lose(name, str(fault))
        except Refused as fault:
            found = failed(self._local, name, str(fault))
        if name == COMPILES and found.outcome == Outcome.FAIL:
            self._stopped = "it does not compile"
        return found

    def end(self) -> None:
        """Kill the processes."""
        self._worker.end()
        self._second.end()

    def _ask(self, name: str) -> Verdict:
        limit = START_SECONDS if name == COMPILES else self._seconds
        found: Verdict = self._worker.ask("check", (name, self._page), limit)
        if name == DETERMINISTIC and found.outcome == Outcome.PASS:
            return self._compare(found)
        return found

    def _compare(self, found: Verdict) -> Verdict:
        """Two processes must answer the same."""
        first = self._worker.ask("answers", (), self._seconds)
        self._second.ask("check", (COMPILES, self._page), START_SECONDS)
        second = self._second.ask("answers", (), self._seconds)
        differs = (first.view(np.uint64) != second.view(np.uint64)).any(axis=1)
        if not differs.any():
            return found
        at = int(np.argmax(differs))
        reason = f"{first[at].tolist()} in one process, {second[at].tolist()} in another"
        return failed(self._local, found.check, reason, ordinary()[at])

    def _lose(self, name: str, reason: str) -> Verdict:
        self._lost += 1
        if self._lost == LOST:
            self._stopped = f"{LOST} processes were lost"
        page = np.fromfile(self._page)
        return failed(self._local, name, reason, from_page(page) if page.any() else None)
