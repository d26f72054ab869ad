"""Siconos' solvers of the local friction-contact problem (`fc3d_driver`)."""

from __future__ import annotations

import importlib
import tempfile
import time
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["Desk"]

SPARSE_BLOCK = 1


class Desk:
    """Problems are in sparse block storage. Contact order (N, T1, T2), as here."""

    def __init__(self) -> None:
        self._numerics = importlib.import_module("siconos.numerics")
        self.version = str(importlib.import_module("siconos").version)

    def lay_out(
        self,
        starts: NDArray[Any],
        columns: NDArray[Any],
        blocks: NDArray[Any],
        b: NDArray[Any],
        mu: NDArray[Any],
    ) -> Any:
        """The problem as Siconos has it: through a text file, the one way that needs nothing but numpy."""
        with tempfile.NamedTemporaryFile("w", suffix=".dat", encoding="ascii") as file:
            file.writelines(_lines(starts, columns, blocks, b, mu))
            file.flush()
            return self._numerics.frictionContact_new_from_filename(file.name)

    def solve(
        self, problem: Any, order: dict[str, Any], start: NDArray[Any]
    ) -> tuple[dict[str, Any], NDArray[Any]]:
        """Solve a fresh copy: some solvers leave other storages of the matrix behind in it."""
        numerics = self._numerics
        options = self._options(order)
        r, u = start.copy(), np.zeros_like(start)
        fresh = numerics.frictionContact_copy(problem)
        began = time.perf_counter()
        info = numerics.fc3d_driver(fresh, r, u, options)
        seconds = time.perf_counter() - began
        numerics.frictionContactProblem_free(fresh)
        found = {
            "claimed": info == 0,
            "iterations": int(options.iparam[numerics.SICONOS_IPARAM_ITER_DONE]),
            "error": float(options.dparam[numerics.SICONOS_DPARAM_RESIDU]),
            "seconds": seconds,
            "note": f"info {info}",
        }
        return found, r

    def _options(self, order: dict[str, Any]) -> Any:
        """Siconos' defaults for a solver, but for limits, tolerance, local solver and error evaluation."""
        numerics = self._numerics
        options = numerics.SolverOptions(self._constant(order["solver"]))
        options.iparam[numerics.SICONOS_IPARAM_MAX_ITER] = order["max_iterations"]
        options.dparam[numerics.SICONOS_DPARAM_TOL] = order["tolerance"]
        if "local" in order:
            numerics.solver_options_update_internal(options, 0, self._constant(order["local"]))
        if order.get("full"):
            at = numerics.SICONOS_FRICTION_3D_IPARAM_ERROR_EVALUATION
            options.iparam[at] = numerics.SICONOS_FRICTION_3D_NSGS_ERROR_EVALUATION_FULL
        return options

    def _constant(self, name: str) -> int:
        return int(getattr(self._numerics, f"SICONOS_FRICTION_3D_{name}"))


def _lines(
    starts: NDArray[Any], columns: NDArray[Any], blocks: NDArray[Any], b: NDArray[Any], mu: NDArray[Any]
) -> Iterator[str]:
    """Siconos' text format: sizes, the matrix in sparse blocks (each by columns), q, mu."""
    n, ends = len(mu), 3 * np.arange(1, len(mu) + 1)
    sizes = (3, n, SPARSE_BLOCK, 3 * n, 3 * n, len(columns), n, n)
    yield from (f"{size}\n" for size in sizes)
    yield _line(ends.tolist())
    yield _line(ends.tolist())
    yield f"{n + 1}\n{len(columns)}\n"
    yield _line(starts.tolist())
    yield _line(columns.tolist())
    for number, block in enumerate(blocks.transpose(0, 2, 1).reshape(-1, 9).tolist()):
        yield f"{number}\n"
        yield _line(block)
    yield _line(b.tolist())
    yield _line(mu.tolist())


def _line(numbers: Iterable[float]) -> str:
    return " ".join(map(repr, numbers)) + "\n"
