"""Load solvers by name: from a package of modules, from entry points, from a file of the user's.

A solver is a module with a docstring and an object named `solver`; of which kinds, the caller says. A specification
is `NAME` or `NAME:option=value,option=value`, for instance `pyramid:facets=8`.
"""

import ast
import importlib
import importlib.util
import pkgutil
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Generic, TypeVar

import numpy as np
from numba.core import config
from numpy.typing import NDArray

from fibercontact.errors import UserError
from fibercontact.jit import cache_folder, content_key
from fibercontact.local.contract import Declared

__all__ = [
    "BUILT_IN",
    "Kinds",
    "Registered",
    "SolverError",
    "built_in",
    "installed",
    "plugins",
    "resolved",
    "with_neighbours",
]

Solver = TypeVar("Solver", bound=Declared, covariant=True)
Kinds = tuple[type[Declared], ...]

BUILT_IN = "built in"
"""Origin of the solvers of this package."""


class SolverError(UserError):
    """A solver that cannot be found, loaded or configured; the message says why."""


@dataclass(frozen=True)
class Registered(Generic[Solver]):
    """A solver by name. `origin` is `built in`, a file, or the package that installed it."""

    name: str
    solver: Solver
    origin: str
    documentation: str
    fingerprint: str

    @property
    def summary(self) -> str:
        """First line of the documentation."""
        return (
            self.documentation.strip().splitlines()[0] if self.documentation.strip() else "(no documentation)"
        )


def resolved(
    specification: str, known: Mapping[str, Registered[Solver]], what: str
) -> tuple[Registered[Solver], NDArray[np.float64], int]:
    """The solver, its option values and its law; raises `SolverError` listing what is known when something is not."""
    name, _, text = specification.partition(":")
    if name not in known:
        raise SolverError(f"unknown {what} {name!r} (known: {', '.join(sorted(known))})")
    given: dict[str, float] = {}
    try:
        for part in filter(None, text.split(",")):
            option, value = part.partition("=")[::2]
            if option.strip() in given:
                raise ValueError(f"option {option.strip()!r} is given twice")
            given[option.strip()] = float(value)
        solver = known[name].solver
        return known[name], solver.option_values(given), solver.law(given)
    except ValueError as error:
        raise SolverError(f"{specification!r}: {error}") from error


def built_in(methods: ModuleType, sources: Iterable[Path], kinds: Kinds) -> Iterator[Registered[Any]]:
    """The modules of a package of ours, whose numbers are decided by these sources."""
    fingerprint = content_key(sources)
    for module in pkgutil.iter_modules(methods.__path__):
        loaded = importlib.import_module(f"{methods.__name__}.{module.name}")
        yield _registered(module.name.replace("_", "-"), loaded, BUILT_IN, fingerprint, kinds)


def installed(point: Any, kinds: Kinds) -> Registered[Any]:
    """What an entry point names: a module with a `solver`, or the solver itself."""
    origin = f"package {point.dist.name if point.dist else 'unknown'}"
    try:
        thing = point.load()
    except Exception as error:  # whatever a stranger's package raises while it is imported
        raise SolverError(f"{origin}: {type(error).__name__}: {error}") from error
    if not isinstance(thing, (ModuleType, *kinds)):
        raise SolverError(f"{origin}: {point.name!r} is neither a module nor a {_names(kinds)}")
    module = thing if isinstance(thing, ModuleType) else sys.modules[point.module]
    fingerprint = content_key([Path(str(module.__file__))])
    if isinstance(thing, ModuleType):
        return _registered(point.name, thing, origin, fingerprint, kinds)
    return Registered(point.name, thing, origin, module.__doc__ or "", fingerprint)


def plugins(paths: Iterable[Path], kinds: Kinds) -> dict[str, Registered[Any]]:
    """Load plugin files; raises `SolverError` when two of them have one name."""
    found: dict[str, Registered[Any]] = {}
    for path in paths:
        entry = plugin(path, kinds)
        if found.setdefault(entry.name, entry).origin != entry.origin:
            raise SolverError(f"{path}: {found[entry.name].origin} is named {entry.name!r}, too")
    return found


def plugin(path: Path, kinds: Kinds) -> Registered[Any]:
    """Load a plugin file; its name is the file's. Edits of it, or of modules beside it, are always seen."""
    if not path.is_file():
        raise SolverError(f"{path}: no such file")
    name = path.stem.replace("_", "-")
    try:
        files = with_neighbours(path)
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
    return _registered(name, sys.modules[identifier], str(path), fingerprint, kinds)


def _registered(
    name: str, module: ModuleType, origin: str, fingerprint: str, kinds: Kinds
) -> Registered[Any]:
    solver = getattr(module, "solver", None)
    if not isinstance(solver, kinds):
        found = f" but a {type(solver).__name__}" if isinstance(solver, Declared) else ""
        raise SolverError(f"{origin}: no {_names(kinds)} named 'solver' in it{found}")
    return Registered(name, solver, origin, module.__doc__ or "", fingerprint)


def _names(kinds: Kinds) -> str:
    return " or ".join(kind.__name__ for kind in kinds)


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


def with_neighbours(path: Path) -> list[Path]:
    """The plugin and the modules beside it that it imports, at any depth.

    Raises `SolverError` when it imports a package beside it: an edit in there would not be seen.
    """
    seen, todo = [path], [path]
    while todo:
        for node in ast.walk(ast.parse(todo.pop().read_bytes())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in {n.split(".")[0] for n in names} - {"", __name__.split(".")[0]}:
                file = path.parent / f"{name}.py"
                if (path.parent / name / "__init__.py").is_file():
                    raise SolverError(
                        f"{path}: {name!r} beside it is a package: only modules can be beside a plugin"
                    )
                if file not in seen and file.is_file():
                    seen.append(file)
                    todo.append(file)
    return seen


@contextmanager
def _own_cache(fingerprint: str) -> Iterator[None]:
    """Compiled code of a plugin goes to a folder named after its content."""
    before, folder = config.CACHE_DIR, cache_folder()
    config.CACHE_DIR = str(folder / f"plugin-{fingerprint}") if folder else ""
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
