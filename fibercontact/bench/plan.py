"""What a run is asked to measure: the rows of a plan, each with its key."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import fibercontact
from fibercontact.bench.environment import cpu_model
from fibercontact.bench.passes import options_text
from fibercontact.bench.problem_set import Entry
from fibercontact.bench.protocol import ACCURACIES, GLOBAL, PROTOCOL, Limits
from fibercontact.bench.rows import RATES, TIMED, Key
from fibercontact.bench.visits import about
from fibercontact.global_methods.registry import AnyConfigured
from fibercontact.jit import content_key
from fibercontact.local.registry import Configured

__all__ = ["Plan", "Unit", "code", "single"]


@dataclass(frozen=True)
class Unit:
    """One row to be measured."""

    entry: Entry
    key: Key
    facets: int

    def about(self) -> dict[str, Any]:
        """What a visit log says of its run before it is made."""
        return about(self.entry, self.key, self.facets, ACCURACIES[self.key.accuracy])


@dataclass(frozen=True)
class Plan:
    """What a run is asked to do; `visits` asks for a visit log of every pass of sweeps that is not timed."""

    entries: Sequence[Entry]
    solvers: Sequence[AnyConfigured]
    timed: Sequence[str]
    rates: Sequence[str] = ()
    start: str = "cold"
    outer: str = "plain"
    repetitions: int = 3
    jobs: int = 1
    limits: Limits = field(default_factory=Limits)
    plugins: Sequence[Path] = ()
    visits: bool = False
    memory: int | None = None
    """Bytes that a worker process may use; a share of the machine's by default."""

    def units(self) -> list[Unit]:
        """The rows that were asked for: the timed accuracies first, problem by problem."""
        return self._units(TIMED, self.timed) + self._units(RATES, self.rates)

    def work(self) -> list[Unit]:
        """All rows to be measured: a timed row needs the row of its pass that is not timed."""
        return self._units(RATES, [*self.timed, *self.rates]) + self._units(TIMED, self.timed)

    def _units(self, mode: str, accuracies: Sequence[str]) -> list[Unit]:
        return [
            Unit(entry, self._key(entry, solver, accuracy, mode), solver.facets)
            for entry in self.entries
            for accuracy in accuracies
            for solver in self.solvers
        ]

    def _key(self, entry: Entry, solver: AnyConfigured, accuracy: str, mode: str) -> Key:
        return Key(
            problem_hash=entry.hash,
            solver=solver.label,
            fingerprint=solver.registered.fingerprint,
            options=options_text(solver),
            accuracy=accuracy,
            start=self.start,
            outer=self.outer if isinstance(solver, Configured) else GLOBAL,
            mode=mode,
            repetitions=self.repetitions if mode == TIMED else 0,
            max_sweeps=self.limits.sweeps,
            max_seconds=self.limits.seconds,
            protocol=PROTOCOL,
            code=code(),
            cpu=cpu_model() if mode == TIMED else "",
        )

    def fingerprints(self) -> dict[str, str]:
        """The sources of the solvers."""
        return {solver.label: solver.registered.fingerprint for solver in self.solvers}


def single(entry: Entry, solver: Configured, accuracy: str, start: str, outer: str, limits: Limits) -> Unit:
    """The row of one solver on one problem, as a table's run would have it."""
    return Plan([entry], [solver], (), (accuracy,), start, outer, limits=limits).work()[0]


def code() -> str:
    """Key of the package's sources that decide the numbers, the local solvers aside."""
    package = Path(fibercontact.__file__).parent
    rooms = [file for room in ("problem", "gauss_seidel") for file in (package / room).rglob("*.py")]
    return content_key([package / "jit.py", package / "lanes.py", package / "bench" / "passes.py", *rooms])
