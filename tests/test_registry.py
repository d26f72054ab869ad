"""Finding local solvers by name, in files and in installed packages; what a plugin's edit changes."""

import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numba
import numpy as np
import pytest

import fibercontact
from fibercontact.local import registry
from fibercontact.local.contract import LocalSolver, Option
from fibercontact.local.registry import SolverError, configure, registered

BUILT_IN = {"dac", "enum-companion", "enum-quartic", "hybrid", "mfb", "pac", "pyramid", "secular"}

PLUGIN = '''"""Push back with a constant impulse.

Reference: none.
"""
from fibercontact.jit import jit
from fibercontact.local.contract import LocalSolver, Option
{imports}

@jit
def kernel(W, b, mu, r, options):
    """Not a solver."""
    return 0, ({normal}, 0.0, options[0]), 0

solver = LocalSolver(kernel, options={{"side": Option(0.5, "second tangential impulse")}})
'''


def plugin(folder, name="constant.py", normal="1.0", imports=""):
    folder.mkdir(exist_ok=True)
    file = folder / name
    file.write_text(PLUGIN.format(normal=normal, imports=imports), encoding="utf-8")
    return file


def answer(solver):
    vector = (1.0, 0.0, 0.0)
    return solver.kernel()((vector,) * 3, vector, 0.5, vector, solver.options)


def test_the_built_in_solvers_are_one_a_file():
    methods = Path(registry.__file__).parent / "methods"
    files = {f.stem.replace("_", "-") for f in methods.glob("*.py")} - {"--init--"}
    known = registered()
    assert {n for n, entry in known.items() if entry.origin == "built in"} == files == BUILT_IN
    assert all(known[n].name == n for n in known)


@pytest.mark.parametrize(
    ("specification", "options", "facets"),
    [
        ("pyramid", [4], 4),
        ("pyramid:facets=8", [8], 8),
        ("mfb", [1e-10, 50], 0),
        ("mfb:max_iterations=7", [1e-10, 7], 0),
        ("mfb:max_iterations=7, tolerance=1e-3", [1e-3, 7], 0),
        ("secular:", [1e-12, 100], 0),
    ],
)
def test_a_specification_sets_options(specification, options, facets):
    configured = configure(specification, registered())
    assert configured.label == specification
    assert configured.facets == facets
    np.testing.assert_array_equal(configured.options, options)


@pytest.mark.parametrize(
    ("specification", "message"),
    [
        ("newton", r"unknown local solver 'newton' \(known: dac, enum-companion, .*secular\)"),
        ("", r"unknown local solver '' \(known: "),
        ("mfb:speed=3", r"unknown option 'speed' \(known: tolerance, max_iterations\)"),
        ("mfb:tolerance=small", "'mfb:tolerance=small'"),
        ("mfb:tolerance", "'mfb:tolerance'"),
        ("mfb:tolerance=nan", "option 'tolerance' is not a number"),
        ("mfb:tolerance=1, tolerance=2", "option 'tolerance' is given twice"),
        ("pyramid:facets=2", "'facets' must be an integer >= 3, not 2"),
        ("pyramid:facets=4.5", "'facets' must be an integer >= 3, not 4.5"),
        ("pyramid:facets=-8", "'facets' must be an integer >= 3, not -8"),
        ("pyramid:facets=nan", "pyramid:facets=nan"),
        ("pyramid:facets=inf", "pyramid:facets=inf"),
    ],
)
def test_a_wrong_specification_is_refused_by_name(specification, message):
    with pytest.raises(SolverError, match=message):
        configure(specification, registered())


def test_a_plugin_is_one_file(tmp_path):
    known = registered([plugin(tmp_path, "my_solver.py")])
    entry = known["my-solver"]
    assert entry.origin == str(tmp_path / "my_solver.py")
    assert entry.summary == "Push back with a constant impulse."
    assert answer(configure("my-solver", known)) == (0, (1.0, 0.0, 0.5), 0)
    assert answer(configure("my-solver:side=2", known)) == (0, (1.0, 0.0, 2.0), 0)
    assert set(known) > BUILT_IN


def test_a_plugin_replaces_a_solver_of_its_name(tmp_path):
    assert registered([plugin(tmp_path, "secular.py")])["secular"].origin != "built in"


def test_two_plugins_of_one_name_are_refused(tmp_path):
    one, other = (plugin(tmp_path / folder) for folder in "ab")
    assert registered([one, one])["constant"].origin == str(one)
    with pytest.raises(SolverError, match=rf"^{other}: {one} is named 'constant', too$"):
        registered([one, other])


def test_fingerprints_follow_the_content(tmp_path):
    file = plugin(tmp_path)
    first = registered([file])["constant"].fingerprint
    assert registered([file])["constant"].fingerprint == first
    assert registered([plugin(tmp_path, normal="2.0")])["constant"].fingerprint != first


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("def kernel(:", "SyntaxError"),
        ("import no_such_module_anywhere", "ModuleNotFoundError.*no_such_module_anywhere"),
        ("1 / 0", "ZeroDivisionError"),
        ("x = 1", "no LocalSolver named 'solver'"),
        ("solver = 3", "no LocalSolver named 'solver'"),
        ("raise SystemExit(3)", "SystemExit"),
        ("\0", "null bytes"),
    ],
)
def test_a_broken_plugin_is_refused_by_the_name_of_its_file(tmp_path, source, message):
    file = tmp_path / "broken.py"
    file.write_text(source, encoding="utf-8")
    with pytest.raises(SolverError, match=message) as caught:
        registered([file])
    assert str(file) in str(caught.value)
    with pytest.raises(SolverError):  # and again: nothing half-loaded is left behind
        registered([file])


def test_a_plugin_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(SolverError, match=r"nowhere\.py: no such file"):
        registered([tmp_path / "nowhere.py"])


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="nothing is compiled")
@pytest.mark.parametrize(
    "body",
    ["return 'no', r, 0", "return 0, (1.0, 2.0), 0", "return 0, unknown_name, 0", "return 0, r.sum(), 0"],
)
def test_a_kernel_that_does_not_compile_is_refused_by_the_name_of_its_file(tmp_path, body):
    file = plugin(tmp_path)
    file.write_text(
        file.read_text(encoding="utf-8").replace("return 0, (1.0, 0.0, options[0]), 0", body),
        encoding="utf-8",
    )
    with pytest.raises(SolverError, match="does not compile to the signature") as caught:
        configure("constant", registered([file])).kernel()
    assert str(file) in str(caught.value)


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="nothing is compiled")
def test_a_kernel_without_the_decorator_is_refused(tmp_path):
    file = plugin(tmp_path)
    file.write_text(file.read_text(encoding="utf-8").replace("@jit", ""), encoding="utf-8")
    with pytest.raises(SolverError, match="not decorated with @jit") as caught:
        configure("constant", registered([file])).kernel()
    assert str(file) in str(caught.value)


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="nothing is compiled")
@pytest.mark.parametrize(
    ("several", "message"),
    [
        ("kernel", r"the several of 'constant' does not compile to .* -> \(done, r, iterations\) on Lanes"),
        ("kernel.py_func", "the several of 'constant' is not decorated with @jit"),
    ],
)
def test_what_solves_several_contacts_is_refused_by_its_own_name(tmp_path, several, message):
    file = plugin(tmp_path)
    source = file.read_text(encoding="utf-8").replace(
        "LocalSolver(kernel", f"LocalSolver(kernel, several={several}"
    )
    file.write_text(source, encoding="utf-8")
    with pytest.raises(SolverError, match=message):
        configure("constant", registered([file])).several()


IMPORTS = "import helper"
HELPER = "from fibercontact.jit import jit\n\n@jit\ndef push(b):\n    return {value}\n"

RUN = """
import sys
from pathlib import Path
from fibercontact.local.registry import configure, registered
solver = configure("constant", registered([Path(sys.argv[1])]))
vector = (1.0, 0.0, 0.0)
kernel = solver.kernel()
status, r, iterations = kernel((vector,) * 3, vector, 0.5, vector, solver.options)
print(r[0], sum(kernel.stats.cache_hits.values()) if hasattr(kernel, "stats") else -1)
"""


def next_process(file, cache):
    """What the plugin answers in a new process, and whether its kernel was read from the disk cache."""
    environment = os.environ | {
        "FIBERCONTACT_CACHE": str(cache),
        "PYTHONPATH": str(Path(fibercontact.__file__).parents[1]),
    }
    environment.pop("NUMBA_CACHE_DIR", None)
    out = subprocess.run(
        [sys.executable, "-c", RUN, str(file)], env=environment, capture_output=True, text=True, check=False
    )
    assert out.returncode == 0, out.stderr
    value, hits = out.stdout.split()
    return float(value), int(hits)


def test_an_edit_of_a_plugin_takes_effect_in_the_next_process(tmp_path):
    """The plugin, then the jitted helper beside it that its kernel calls; unedited, the cache serves."""
    compiled = not numba.config.DISABLE_JIT
    folder, cache = tmp_path / "mine", tmp_path / "cache"
    file = plugin(folder, normal="helper.push(b)", imports=IMPORTS)
    (folder / "helper.py").write_text(HELPER.format(value="2.0"), encoding="utf-8")
    assert next_process(file, cache) == (2.0, 0 if compiled else -1)
    assert next_process(file, cache) == (2.0, 1 if compiled else -1)
    (folder / "helper.py").write_text(HELPER.format(value="3.0"), encoding="utf-8")
    assert next_process(file, cache)[0] == 3.0
    plugin(folder, normal="10.0 + helper.push(b)", imports=IMPORTS)
    assert next_process(file, cache)[0] == 13.0


def test_an_edit_of_a_plugin_takes_effect_in_the_same_process(tmp_path):
    for value in ("5.0", "6.0"):
        file = plugin(tmp_path, normal=value)
        assert answer(configure("constant", registered([file])))[1][0] == float(value)


def test_plugins_do_not_share_the_helpers_beside_them(tmp_path):
    answers = []
    for value in ("7.0", "8.0"):
        folder = tmp_path / value
        file = plugin(folder, normal="helper.push(b)", imports=IMPORTS)
        (folder / "helper.py").write_text(HELPER.format(value=value), encoding="utf-8")
        answers.append(answer(configure("constant", registered([file])))[1][0])
    assert answers == [7.0, 8.0]


@pytest.mark.parametrize("imports", ["import helper", "import helper.push", "from helper.push import push"])
def test_a_package_beside_a_plugin_is_refused(tmp_path, imports):
    """Compiled code is kept by the sources of the modules beside a plugin; what is in a package would go stale."""
    file = plugin(tmp_path, imports=imports)
    (tmp_path / "helper").mkdir()
    (tmp_path / "helper" / "__init__.py").touch()
    with pytest.raises(SolverError, match=r"constant\.py: 'helper' beside it is a package"):
        registered([file])


def entry_point(name, thing, distribution="somewhere"):
    def load():
        if isinstance(thing, Exception):
            raise thing
        return thing

    return SimpleNamespace(
        name=name, load=load, module="somebody_s_solver", dist=SimpleNamespace(name=distribution)
    )


def offer(monkeypatch, *points):
    monkeypatch.setattr(
        registry, "entry_points", lambda group: points if group == registry.ENTRY_POINTS else ()
    )


def installed_module():
    def kernel(W, b, mu, r, options):
        return 0, r, 0

    module = ModuleType("somebody_s_solver", "Keep the impulse.")
    module.__file__ = __file__
    kernel.__module__ = module.__name__
    module.solver = LocalSolver(kernel, options={"a": Option(1.0, "nothing")})
    return module


@pytest.mark.parametrize("what", ["module", "solver"])
def test_an_installed_package_adds_a_solver(monkeypatch, what):
    module = installed_module()
    monkeypatch.setitem(sys.modules, module.__name__, module)
    offer(monkeypatch, entry_point("theirs", module if what == "module" else module.solver))
    entry = registered()["theirs"]
    assert (entry.origin, entry.summary, entry.solver) == (
        "package somewhere",
        "Keep the impulse.",
        module.solver,
    )
    np.testing.assert_array_equal(configure("theirs:a=3", registered()).options, [3.0])


def test_an_installed_package_without_a_solver_is_named(monkeypatch):
    module = ModuleType("empty")
    module.__file__ = __file__
    offer(monkeypatch, entry_point("theirs", module))
    with pytest.raises(SolverError, match="package somewhere: no LocalSolver"):
        registered()


@pytest.mark.parametrize("thing", [ImportError("no module named theirs"), 3])
def test_an_installed_package_that_does_not_load_is_named(monkeypatch, thing):
    offer(monkeypatch, entry_point("theirs", thing))
    with pytest.raises(SolverError, match="somewhere"):
        registered()
