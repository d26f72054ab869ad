"""The layout is the data flow: a module imports only from its own room and from rooms before it."""

import ast
from pathlib import Path

import pytest

import fibercontact
from fibercontact.jit import KERNEL_ROOMS

ROOMS = [
    "errors", "files", "jit", "lanes", "threads", "rods", "contact", "problem", "local", "gauss_seidel",
    "global_methods", "peers", "simulation", "reference", "bench", "cli", "__main__"
]  # fmt: skip
ANYWHERE = "fibercontact"  # the package itself: its version and nothing else


def imported(source, module):
    """Names of this package's modules that a source imports, at any depth; relative imports resolved."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = module.split(".")[: -node.level] if node.level else []
            stem = ".".join([*base, *([node.module] if node.module else [])])
            names = [f"{stem}.{a.name}" for a in node.names] if stem == ANYWHERE else [stem]
        else:
            continue
        yield from (name for name in names if name.split(".")[0] == ANYWHERE)


def room(name):
    parts = name.split(".")
    return parts[1] if len(parts) > 1 and parts[1] != "__version__" else ANYWHERE


def module_name(file, package):
    return ".".join((ANYWHERE, *file.relative_to(package).with_suffix("").parts))


def violations(package):
    """Sentences about the imports that go against the flow, and the modules in no room."""
    rank = {name: k for k, name in enumerate(ROOMS)} | {ANYWHERE: -1}
    faults = []
    for file in sorted(package.rglob("*.py")):
        module = module_name(file, package)
        here = ANYWHERE if file == package / "__init__.py" else room(module)
        if here not in rank:
            faults.append(f"{module} is in no room")
            continue
        names = imported(file.read_text(encoding="utf-8"), module)
        against = (name for name in names if rank.get(room(name), len(ROOMS)) > rank[here])
        faults += [f"{module} imports {name}" for name in against]
    return faults


def test_modules_import_only_from_rooms_before_theirs():
    package = Path(fibercontact.__file__).parent
    assert len(list(package.rglob("*.py"))) > 20
    assert violations(package) == []


@pytest.mark.parametrize(
    ("file", "source", "fault"),
    [
        ("rods/a.py", "from fibercontact.problem.cone import norm", "{0}.rods.a imports {0}.problem.cone"),
        ("contact/a.py", "import fibercontact.problem.step", "{0}.contact.a imports {0}.problem.step"),
        ("problem/a.py", "def f():\n  from fibercontact import local", "{0}.problem.a imports {0}.local"),
        ("local/a.py", "from ..gauss_seidel import loop", "{0}.local.a imports {0}.gauss_seidel"),
        ("jit.py", "from . import rods", "{0}.jit imports {0}.rods"),
        ("bench/a.py", "from fibercontact.attic import b", "{0}.bench.a imports {0}.attic"),
        ("attic/a.py", "", "{0}.attic.a is in no room"),
    ],
)  # fmt: skip
def test_an_import_against_the_flow_is_found(tmp_path, file, source, fault):
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / file).write_text(source, encoding="utf-8")
    assert violations(tmp_path) == [fault.format("fibercontact")]


@pytest.mark.parametrize(
    ("file", "source"),
    [
        ("__init__.py", "__version__ = '1'"),
        ("rods/a.py", "import numpy\nfrom fibercontact.jit import jit\nfrom fibercontact.rods import b"),
        (
            "cli/a.py",
            "from fibercontact import __version__\nfrom fibercontact.rods.model import Rods\nfrom .b import c",
        ),
        ("local/methods/a.py", "from ...problem.cone import project\nfrom ..contract import Status"),
    ],
)
def test_an_import_with_the_flow_is_accepted(tmp_path, file, source):
    (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / file).write_text(source, encoding="utf-8")
    assert violations(tmp_path) == []


def test_only_the_kernel_rooms_compile():
    """The folder of compiled code is named after the sources of these rooms alone."""
    package = Path(fibercontact.__file__).parent
    for file in package.rglob("*.py"):
        imports = [
            node for node in ast.walk(ast.parse(file.read_text("utf-8"))) if isinstance(node, ast.ImportFrom)
        ]
        names = {alias.name for node in imports if node.module == "fibercontact.jit" for alias in node.names}
        compiles = bool(names & {"jit", "jit_inline", "jit_sum"})
        assert not compiles or file.relative_to(package).parts[0] in KERNEL_ROOMS, file
