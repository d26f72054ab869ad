"""Find local solvers by name: built in, installed as entry points, or in a file of the user's."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import numpy as np
from numba.core import config
from numba.core.errors import NumbaError
from numpy.typing import NDArray

from fibercontact.local import methods
from fibercontact.local.contract import KERNEL_SIGNATURE, SEVERAL_SIGNATURE, LocalSolver
from fibercontact.local.loading import Registered, SolverError, built_in, installed, plugins, resolved

__all__ = [
    "ENTRY_POINTS", "SOURCES", "Configured", "Registered", "SolverError", "configure", "offered", "registered"
]  # fmt: skip

ENTRY_POINTS = "fibercontact.local_solvers"
SOURCES = Path(methods.__file__).parents[1]
"""The folder whose sources decide what the built-in solvers compute."""


@dataclass(frozen=True)
class Configured:
    """A local solver with its options set: what a row of the table is about."""

    label: str
    registered: Registered[LocalSolver]
    options: NDArray[np.float64]
    facets: int

    def kernel(self) -> Any:
        """The compiled kernel; compiled on first use, read from the disk cache afterwards.

        Raises `SolverError` when the kernel does not compile to the signature of the contract.
        """
        return self._compiled("kernel", KERNEL_SIGNATURE)

    def several(self) -> Any:
        """The compiled kernel for several contacts at once, None where the solver has none; raises `SolverError`."""
        return self.registered.solver.several and self._compiled("several", SEVERAL_SIGNATURE)

    def _compiled(self, name: str, signature: Any) -> Any:
        kernel = getattr(self.registered.solver, name)
        if config.DISABLE_JIT:
            return kernel
        place = f"{self.registered.origin}: the {name} of {self.label!r}"
        try:
            if not kernel.signatures:
                kernel.compile(signature)
                kernel.disable_compile()
        except AttributeError as error:
            raise SolverError(f"{place} is not decorated with @jit") from error
        except NumbaError as error:
            answer = "(status, r, iterations)" if name == "kernel" else "(done, r, iterations) on Lanes"
            raise SolverError(
                f"{place} does not compile to the signature (W, b, mu, r, options) -> {answer}: "
                f"{_in_short(str(error))}"
            ) from error
        return kernel


def _in_short(error: str) -> str:
    """What the compiler complains of and where, without the story of how it came there."""
    lines = [line.strip() for line in error.splitlines() if line.strip()]
    story = (
        "Failed in",
        "During:",
        "There are",
        "- Of which",
        "Overload",
        "With argument",
        "No match",
        "File ",
        "Enable",
    )
    told = [line for line in lines if not line.startswith(story)]
    place = re.findall(r'File "[^"]*?([^"/\\]+)", (line \d+)', error)
    return " ".join([*told[:2], *(f"({file}, {line})" for file, line in place[-1:])])


def registered(files: Sequence[Path] = ()) -> dict[str, Registered[LocalSolver]]:
    """Every local solver that can be had, by name; raises `SolverError` when a plugin file does not load."""
    return offered() | plugins(files, (LocalSolver,))


def offered() -> dict[str, Registered[LocalSolver]]:
    """The local solvers that are built in or installed."""
    found = {entry.name: entry for entry in built_in(methods, SOURCES.rglob("*.py"), (LocalSolver,))}
    for point in entry_points(group=ENTRY_POINTS):
        found[point.name] = installed(point, (LocalSolver,))
    return found


def configure(specification: str, known: Mapping[str, Registered[LocalSolver]]) -> Configured:
    """Resolve `NAME[:option=value,...]`; raises `SolverError` listing what is known when something is not."""
    return Configured(specification, *resolved(specification, known, "local solver"))
