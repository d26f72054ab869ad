"""Find solvers of either kind by name: local solvers, and global methods beside them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import eye_array

from fibercontact.gauss_seidel.blocks import BlockSystem, block_system
from fibercontact.global_methods import methods
from fibercontact.global_methods.contract import Answer, GlobalMethod, Task
from fibercontact.local import registry as local
from fibercontact.local.contract import LocalSolver
from fibercontact.local.loading import (
    BUILT_IN,
    Registered,
    SolverError,
    built_in,
    installed,
    plugins,
    resolved,
)
from fibercontact.local.registry import Configured
from fibercontact.problem.incremental import IncrementalProblem

__all__ = [
    "ENTRY_POINTS", "AnyConfigured", "AnyRegistered", "ConfiguredMethod", "configure", "is_global", "registered"
]  # fmt: skip

ENTRY_POINTS = "fibercontact.global_methods"

AnyRegistered = Registered[LocalSolver | GlobalMethod]


@dataclass(frozen=True)
class ConfiguredMethod:
    """A global method with its options set: what a row of the table is about."""

    label: str
    registered: Registered[GlobalMethod]
    options: NDArray[np.float64]
    facets: int

    def prepare(self) -> None:
        """What is done once before any clock starts; ours are run on one contact, a stranger's might hang there."""
        if self.registered.solver.prepare is not None:
            self.registered.solver.prepare()
        elif self.registered.origin == BUILT_IN:
            self.solve(_one_contact(), Task(1e-8, 1.0, 9, math.inf))

    def solve(self, system: BlockSystem, task: Task) -> Answer:
        """Solve a problem; raises `SolverError` when what comes back is no answer to it."""
        found = self.registered.solver.solve(system, task, self.options.copy())
        if not isinstance(found, Answer):
            raise SolverError(f"{self.label}: gave a {type(found).__name__}, no Answer")
        if np.shape(found.r) != system.b.shape:
            raise SolverError(
                f"{self.label}: gave impulses of shape {np.shape(found.r)}, not {system.b.shape}"
            )
        return replace(found, r=np.array(found.r, dtype=np.float64))


def _one_contact() -> BlockSystem:
    """A unit mass on a plane, pushed down and aside."""
    b = np.array([-1.0, 0.5, 0.0])
    return block_system(IncrementalProblem.from_sparse(eye_array(3), b, np.array([0.3])))


AnyConfigured = Configured | ConfiguredMethod


def is_global(entry: AnyRegistered) -> bool:
    """Whether it takes the whole problem."""
    return isinstance(entry.solver, GlobalMethod)


def registered(files: Sequence[Path] = ()) -> dict[str, AnyRegistered]:
    """Every solver that can be had, by name; raises `SolverError` when a plugin does not load.

    A plugin is a file with a `LocalSolver` or a `GlobalMethod`.
    """
    found: dict[str, AnyRegistered] = {**local.offered()}
    sources = [*Path(methods.__file__).parents[1].rglob("*.py"), *local.SOURCES.rglob("*.py")]
    for entry in built_in(methods, sources, (GlobalMethod,)):
        found[entry.name] = entry
    for point in entry_points(group=ENTRY_POINTS):
        found[point.name] = installed(point, (GlobalMethod,))
    return found | plugins(files, (LocalSolver, GlobalMethod))


def configure(specification: str, known: Mapping[str, AnyRegistered]) -> AnyConfigured:
    """Resolve `NAME[:option=value,...]`; raises `SolverError` listing what is known when something is not."""
    entry, options, facets = resolved(specification, known, "solver")
    if isinstance(entry.solver, LocalSolver):
        return Configured(specification, entry, options, facets)  # type: ignore[arg-type]
    return ConfiguredMethod(specification, entry, options, facets)  # type: ignore[arg-type]
