"""Find local solvers by name: built in, installed as entry points, or in a file of the user's.

A specification is `NAME` or `NAME:option=value,option=value`, for instance `pyramid:facets=8`.
"""

import ast
import importlib
import importlib.util
import pkgutil
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numba.core import config
from numba.core.errors import NumbaError
from numpy.typing import NDArray

from fibercontact.errors import UserError
from fibercontact.jit import cache_folder, content_key
from fibercontact.local import methods
from fibercontact.local.contract import KERNEL_SIGNATURE, LocalSolver

__all__ = ["ENTRY_POINTS", "Configured", "Registered", "SolverError", "configure", "registered"]

ENTRY_POINTS = "fibercontact.local_solvers"


class SolverError(UserError):
    """A local solver that cannot be found, loaded or configured; the message says why."""


@dataclass(frozen=True)
class Registered:
    """A local solver by name. `origin` is `built in`, a file, or the package that installed it."""

    name: str
    solver: LocalSolver
    origin: str
    documentation: str
    fingerprint: str

    @property
    def summary(self) -> str:
        """First line of the documentation."""
        return (
            self.documentation.strip().splitlines()[0] if self.documentation.strip() else "(no documentation)"
        )


@dataclass(frozen=True)
class Configured:
    """A local solver with its options set: what a row of the table is about."""

    label: str
    registered: Registered
    options: NDArray[np.float64]
    facets: int

    def kernel(self) -> Any:
        """The compiled kernel; compiled on first use, read from the disk cache afterwards.

        Raises `SolverError` when the kernel does not compile to the signature of the contract.
        """
        kernel = self.registered.solver.kernel
        if config.DISABLE_JIT:
            return kernel
        try:
            if not kernel.signatures:
                kernel.compile(KERNEL_SIGNATURE)
                kernel.disable_compile()
        except AttributeError as error:
            raise SolverError(
                f"{self.registered.origin}: the kernel of {self.label!r} is not decorated with @jit"
            ) from error
        except NumbaError as error:
            raise SolverError(
                f"{self.registered.origin}: the kernel of {self.label!r} does not compile to the signature "
                f"(W, b, mu, r, options) -> (status, r, iterations): {_in_short(str(error))}"
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


def registered(plugins: Sequence[Path] = ()) -> dict[str, Registered]:
    """Every local solver that can be had, by name; raises `SolverError` when a plugin does not load."""
    found = {entry.name: entry for entry in _built_in()}
    for point in entry_points(group=ENTRY_POINTS):
        found[point.name] = _installed(point)
    for path in plugins:
        entry = _plugin(path)
        found[entry.name] = entry
    return found


def configure(specification: str, known: dict[str, Registered]) -> Configured:
    """Resolve `NAME[:option=value,...]`; raises `SolverError` listing what is known when something is not."""
    name, _, text = specification.partition(":")
    if name not in known:
        raise SolverError(f"unknown local solver {name!r} (known: {', '.join(sorted(known))})")
    given: dict[str, float] = {}
    try:
        for part in filter(None, text.split(",")):
            option, _, value = part.partition("=")
            given[option.strip()] = float(value)
        solver = known[name].solver
        values, facets = solver.option_values(given), solver.law(given)
    except ValueError as error:
        raise SolverError(f"{specification!r}: {error}") from error
    return Configured(specification, known[name], values, facets)


def _built_in() -> Iterator[Registered]:
    package = Path(methods.__file__).parents[1]
    fingerprint = content_key(package.rglob("*.py"))
    for module in pkgutil.iter_modules(methods.__path__):
        loaded = importlib.import_module(f"{methods.__name__}.{module.name}")
        yield _registered(module.name.replace("_", "-"), loaded, "built in", fingerprint)


def _registered(name: str, module: ModuleType, origin: str, fingerprint: str) -> Registered:
    solver = getattr(module, "solver", None)
    if not isinstance(solver, LocalSolver):
        raise SolverError(f"{origin}: no LocalSolver named 'solver' in it")
    return Registered(name, solver, origin, module.__doc__ or "", fingerprint)


def _installed(point: Any) -> Registered:
    """An entry point names a module with a `solver`, or a `LocalSolver` itself."""
    origin = f"package {point.dist.name if point.dist else 'unknown'}"
    try:
        thing = point.load()
    except Exception as error:  # whatever a stranger's package raises while it is imported
        raise SolverError(f"{origin}: {type(error).__name__}: {error}") from error
    if not isinstance(thing, ModuleType | LocalSolver):
        raise SolverError(f"{origin}: {point.name!r} is neither a module nor a LocalSolver")
    module = thing if isinstance(thing, ModuleType) else sys.modules[thing.kernel.__module__]
    if isinstance(thing, LocalSolver):
        module.solver = thing  # type: ignore[attr-defined]
    file = Path(str(module.__file__))
    return _registered(point.name, module, origin, content_key([file]))


def _plugin(path: Path) -> Registered:
    """Load a plugin file; its name is the file's. Edits of it, or of modules beside it, are always seen."""
    if not path.is_file():
        raise SolverError(f"{path}: no such file")
    name = path.stem.replace("_", "-")
    try:
        files = _with_neighbours(path)
        fingerprint = content_key(files)
        identifier = f"fibercontact_plugin_{path.stem}_{fingerprint}"
        if identifier not in sys.modules:
            for stem in {file.stem for file in files[1:]} - sys.stdlib_module_names:
                sys.modules.pop(stem, None)  # another plugin's, or this one's before an edit
            _load(path, identifier, fingerprint)
    except SolverError:
        raise
    except (Exception, SystemExit) as error:  # whatever a stranger's file raises while it is imported
        raise SolverError(f"{path}: {type(error).__name__}: {error}") from error
    return _registered(name, sys.modules[identifier], str(path), fingerprint)


def _load(path: Path, identifier: str, fingerprint: str) -> None:
    specification = importlib.util.spec_from_file_location(identifier, path)
    if specification is None or specification.loader is None:
        raise SolverError(f"{path}: not a Python file")
    module = importlib.util.module_from_spec(specification)
    sys.modules[identifier] = module
    try:
        with _own_cache(fingerprint), _importable(path.parent):
            specification.loader.exec_module(module)
    except BaseException:
        del sys.modules[identifier]
        raise


def _with_neighbours(path: Path) -> list[Path]:
    """The plugin and the modules beside it that it imports, at any depth."""
    seen, todo = [path], [path]
    while todo:
        for node in ast.walk(ast.parse(todo.pop().read_bytes())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for file in (path.parent / f"{n.split('.')[0]}.py" for n in names):
                if file not in seen and file.is_file():
                    seen.append(file)
                    todo.append(file)
    return seen


@contextmanager
def _own_cache(fingerprint: str) -> Iterator[None]:
    """Compiled code of a plugin goes to a folder named after its content."""
    before = config.CACHE_DIR
    config.CACHE_DIR = str(cache_folder() / f"plugin-{fingerprint}")
    try:
        yield
    finally:
        config.CACHE_DIR = before


@contextmanager
def _importable(folder: Path) -> Iterator[None]:
    """Let a plugin import the modules beside it, compiled from their sources as they are."""
    writes = sys.dont_write_bytecode
    sys.path.insert(0, str(folder))
    sys.dont_write_bytecode = True  # its check of the time of an edit is too coarse
    try:
        yield
    finally:
        sys.dont_write_bytecode = writes
        sys.path.remove(str(folder))
