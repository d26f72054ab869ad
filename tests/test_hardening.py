"""Broken files at the command line, full and read-only disks, odd names, no cache, narrow screens, interruptions."""

import errno
import os
import pty
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from mutations import device, pipe, put, seed_files
from oracles import strands, walls
from typer.testing import CliRunner

import fibercontact
from fibercontact import jit
from fibercontact.bench.figures import save
from fibercontact.bench.rows import RowFile
from fibercontact.cli import app
from fibercontact.cli.explain import _paragraph
from fibercontact.cli.screen import print_table, screen
from fibercontact.files import replace_file
from fibercontact.jit import cache_folder
from fibercontact.problem.fclib import read, write
from fibercontact.simulation.corpus import write_manifest

CODE = str(Path(fibercontact.__file__).parents[1])


def call(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def is_one_error(result, *parts):
    """Whether a command has ended with one line about an error that has these parts."""
    assert result.exit_code == 2, result.output
    assert isinstance(result.exception, SystemExit)
    line = [line for line in result.stderr.splitlines() if "row" not in line][-1]
    assert line.startswith("error: ")
    for part in parts:
        assert str(part) in line
    return True


# Broken files


def cut(path):
    path.write_bytes(path.read_bytes()[:700])


def changed(change):
    def break_it(path):
        with h5py.File(path, "r+") as file:
            change(file)

    return break_it


BROKEN = {
    "cut": (cut, "not a readable HDF5 file"),
    "pipe": (lambda path: pipe(None, path), "not a file on a disk"),
    "device": (lambda path: device(np.random.default_rng(0), path), "not a file on a disk"),
    "huge": (
        changed(lambda f: put(f, "fclib_global/vectors/w", (2**40,), dtype="f8", chunks=(1000,))),
        "vectors/w has an impossible size",
    ),
    "link": (
        changed(lambda f: (f.pop("fclib_global/M"), f.__setitem__("fclib_global/M", h5py.SoftLink("/")))),
        "fclib_global/M is a link",
    ),
    "NaN": (
        changed(lambda f: f["fclib_global/vectors/mu"].write_direct(np.full(4, np.nan))),
        "mu is not finite",
    ),
}
COMMANDS = {
    "info": "info FILE",
    "solve": "solve FILE --solver secular",
    "explain": "explain FILE secular --out OUT",
    "render": "render FILE --out OUT/a.html",
    "table": "table --set SET --solvers secular --rates low --out OUT --jobs 1",
    "validate": "validate --set SET --solvers secular --out OUT --references OUT/r.hdf5",
    "reference": "reference SET --out OUT/r.hdf5 --jobs 1",
}
CASES = [(command, how) for command in ("info", "solve", "explain", "render") for how in BROKEN] + [
    (command, how) for command in ("table", "validate", "reference") for how in ("NaN", "pipe")
]


@pytest.mark.parametrize(("command", "how"), CASES)
def test_a_broken_file_is_one_line(tmp_path, command, how):
    path = tmp_path / "set" / "broken.hdf5"
    path.parent.mkdir()
    write(path, strands(1, rods=3, dofs=6, contacts=4))
    with h5py.File(path, "r+") as file:  # as FCLIB stores it
        put(file, "fclib_global/vectors/mu", data=np.full(4, 0.5))
    damage, fault = BROKEN[how]
    damage(path)
    (tmp_path / "out").mkdir()
    places = {"FILE": path, "SET": path.parent}
    arguments = [
        str(places.get(a, a)).replace("OUT", str(tmp_path / "out")) for a in COMMANDS[command].split()
    ]
    result = call(*arguments)
    assert is_one_error(result, path.name, fault if command not in ("explain", "render") else "")


# Full disks


@pytest.fixture
def sound(tmp_path):
    """A file that can be solved."""
    write(tmp_path / "sound.hdf5", strands(1))
    return tmp_path / "sound.hdf5"


@pytest.fixture
def full_disk(monkeypatch):
    """Drafts of files go to a device that is full."""
    made = iter(range(1000))

    def mkstemp(suffix, prefix, folder):
        draft = Path(folder, f"{prefix}{next(made)}{suffix}")
        draft.symlink_to("/dev/full")
        return os.open(os.devnull, os.O_RDONLY), str(draft)

    monkeypatch.setattr(tempfile, "mkstemp", mkstemp)


def figure():
    from matplotlib.figure import Figure

    return Figure()


WRITERS = {
    "problem.hdf5": lambda file: write(file, strands(1)),
    "figure.svg": lambda file: save(figure(), file.parent, file.stem),
    "manifest.csv": lambda file: write_manifest(file.parent, []),
    "text.md": lambda file: replace_file(file, b"x"),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_leaves_the_old_file_and_names_it(tmp_path, full_disk, name):
    file = tmp_path / name
    file.write_text("old")
    with pytest.raises(OSError, match="No space left") as caught:
        WRITERS[name](file)
    assert caught.value.filename == str(file)
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {name: "old"}


def test_a_full_disk_is_one_line(tmp_path, sound, full_disk):
    out, run = tmp_path / "b.hdf5", tmp_path / "run"
    result = call("solve", sound, "--solver", "secular", "--out", out)
    assert is_one_error(result, f"{out}: No space left on device")
    assert not out.exists()
    result = call("simulate", "wisp-straight-19-mu0.3", "--steps", "1", "--out", run)
    assert is_one_error(result, f"{run / 'steps.csv'}: No space left on device")


def test_rows_that_cannot_be_written_name_their_file(tmp_path):
    (tmp_path / "rows.jsonl").symlink_to("/dev/full")
    rows = RowFile(tmp_path)
    with pytest.raises(OSError, match="No space left") as caught, rows.appending():
        rows.append({"a": 1})
    assert caught.value.filename == str(tmp_path / "rows.jsonl")


@pytest.mark.parametrize("code", [errno.EROFS, errno.EACCES])
def test_a_folder_that_cannot_be_written_to_is_one_line(tmp_path, sound, monkeypatch, code):
    out = tmp_path / "b.hdf5"

    def refused(*_):
        raise OSError(code, os.strerror(code), str(tmp_path / ".b.x7"))

    monkeypatch.setattr(tempfile, "mkstemp", refused)
    result = call("solve", sound, "--solver", "secular", "--out", out)
    assert is_one_error(result, f"{out}: {os.strerror(code)}")


# Names


@pytest.mark.parametrize("name", ["Löckchen – 頭髪 🧵\nund [red] %d{}", "-v", "x" * 200])
def test_any_name_will_do(tmp_path, monkeypatch, name):
    folder = tmp_path / name
    folder.mkdir()
    monkeypatch.chdir(tmp_path)
    file = Path(name, f"{name}.hdf5")
    write(file, strands(1))
    for command in (
        ["info", "--", file],
        ["solve", "--solver", "secular", f"--out={Path(name, 'answer.hdf5')}", "--", file],
        ["explain", f"--out={Path(name, 'why')}", "--", file, "secular"],
    ):
        result = call(*command)
        assert result.exit_code == 0, result.output
    assert read(Path(name, "answer.hdf5")).solution is not None
    Path(name, "answer.hdf5").unlink()
    result = call(
        "table", f"--set={name}", "--solvers=secular", "--rates=low", "--jobs=1", f"--out={name}/run"
    )
    assert result.exit_code == 0, result.output
    assert (folder / "run" / "table.csv").is_file()


# Compiled code


KERNEL = """
from pathlib import Path
{before}
from fibercontact.jit import jit
def twice(x):
    return 2 * x
import oracles
twice.__code__ = twice.__code__.replace(co_filename=oracles.__file__)
kernel = jit(twice)
print(kernel(21), kernel(1.5))
"""


def child(*arguments, **environment):
    path = os.pathsep.join([CODE, str(Path(__file__).parent)])
    return subprocess.run(
        [sys.executable, *map(str, arguments)], capture_output=True, text=True, check=False,
        env=os.environ | {"PYTHONPATH": path} | environment,
    )  # fmt: skip


@pytest.mark.parametrize("why", ["a file is there", "no home", "full disk"])
def test_without_a_folder_for_compiled_code_the_kernels_run_and_one_line_says_so(tmp_path, why):
    (tmp_path / "file").write_text("")
    environment = {
        "FIBERCONTACT_CACHE": str(tmp_path / ("file/cache" if why == "a file is there" else "cache"))
    }
    before = {
        "a file is there": "",
        "no home": "def home(): raise RuntimeError('no home')\nPath.home = home",
        "full disk": "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))",
    }[why]
    if why == "no home":
        environment = {"FIBERCONTACT_CACHE": "", "XDG_CACHE_HOME": ""}
    result = child("-W", "always", "-c", KERNEL.format(before=before), **environment)
    assert result.stdout == "42 3.0\n", result.stderr
    assert result.stderr.count("no folder to keep compiled code in") == 1
    assert "Traceback" not in result.stderr


def test_only_older_compiled_code_is_forgotten(tmp_path, monkeypatch):
    """The root may be a folder in which other things are, whatever their names."""
    theirs = [tmp_path / f"family-photos-{k:02d}" for k in range(12)]
    older = [tmp_path / f"{k:016x}" for k in range(12)]
    for age, folder in enumerate([*older, *theirs]):
        folder.mkdir()
        os.utime(folder, (age, age))
    monkeypatch.setenv("FIBERCONTACT_CACHE", str(tmp_path))
    current = cache_folder.__wrapped__()
    assert set(tmp_path.iterdir()) == {current, *older[-7:], *theirs}


def test_the_folder_that_numba_is_given_is_a_root(tmp_path):
    """What is right in it for one version of the sources would be read for another, too."""
    show = "import fibercontact.jit as m; from numba.core import config; print(config.CACHE_DIR, m.cache_folder())"
    used, named = child("-c", show, FIBERCONTACT_CACHE="", NUMBA_CACHE_DIR=str(tmp_path)).stdout.split()
    assert used == named
    assert Path(used).parent == tmp_path


def test_the_command_line_says_it_on_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    seeds = seed_files(tmp_path / "seeds")
    result = child(
        "-m",
        "fibercontact",
        "info",
        seeds[0],
        FIBERCONTACT_CACHE=str(tmp_path / "file" / "cache"),
        NUMBA_DISABLE_JIT="1",
    )
    assert result.returncode == 0
    assert result.stderr.startswith("warning: no folder to keep compiled code in (")
    assert result.stderr.count("\n") == 1


# Screens


TABLE = pd.DataFrame(
    {"solver": ["pac", "pyramid:facets=16"]}
    | {f"a column of some {k}": [f"{k} of {10**k}", "–"] for k in range(12)}
    | {"reasons": ["outer 12, local 3, time 1, crash 2, nothing else", ""]}
)


@pytest.mark.parametrize("columns", [60, 80, 120, 200])
def test_a_table_fits_on_the_screen_and_keeps_every_cell(monkeypatch, capsys, columns):
    monkeypatch.setenv("COLUMNS", str(columns))
    print_table(screen(), "title", TABLE, texts=("solver", "reasons"))
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= columns
    cells = [cell.strip() for line in lines for cell in line.split("│")]
    for column in TABLE.columns[:-1]:
        assert TABLE[column][0] in cells
    assert cells.count("pac") == sum("┏" in line for line in lines)  # each part says what its lines are about
    assert [line for line in lines if "title" in line] == lines[:1]


def test_square_brackets_are_text(capsys):
    """Not the markup of the library that draws the tables."""
    print_table(screen(), "a [red] title", pd.DataFrame({"a [b] column": ["run[old]", "[/]"]}))
    text = capsys.readouterr().out
    assert [said in text for said in ("a [red] title", "a [b] column", "run[old]", "[/]")] == [True] * 4


@pytest.mark.parametrize("columns", [60, 80, 100, 200])
def test_explanations_fit_on_the_screen(monkeypatch, columns):
    monkeypatch.setenv("COLUMNS", str(columns))
    lines = _paragraph("what", "a word or two " * 60).splitlines()
    assert max(map(len, lines)) <= min(columns, 100)
    assert max(map(len, lines)) > min(columns, 100) - 10


def test_a_dumb_terminal_gets_plain_text(tmp_path):
    ours, theirs = pty.openpty()
    environment = os.environ | {"TERM": "dumb", "NO_COLOR": "1", "COLUMNS": "60", "PYTHONPATH": CODE}
    command = [sys.executable, "-m", "fibercontact", "simulate", "wisp-straight-19-mu0.3", "--steps", "1"]
    done = subprocess.run(command, stdin=theirs, stdout=theirs, stderr=theirs, env=environment, check=False)
    os.close(theirs)
    text = os.read(ours, 10**5).decode()
    os.close(ours)
    assert done.returncode == 0
    assert "1 steps" in text
    assert "\x1b" not in text


def test_characters_that_a_terminal_lacks_are_no_error(tmp_path):
    seeds = seed_files(tmp_path / "seeds")
    result = child("-m", "fibercontact", "info", seeds[0], PYTHONIOENCODING="ascii")
    assert result.returncode == 0, result.stderr
    assert "a hair" in result.stdout


# Interruptions

READY = """
try:
    print("ready", flush=True)
    from fibercontact.__main__ import main
except KeyboardInterrupt:
    raise SystemExit("interrupted before there was anything to interrupt")
main()
"""
LATE = """
import os


class Last:
    def __del__(self, kill=os.kill, process=os.getpid()):
        kill(process, {code})


last = Last()  # goes with the module, when Python has put back what signals do by themselves
from fibercontact.__main__ import main
main()
"""
LONG = {
    "solve": "solve WALLS --solver pac --max-sweeps 100000000 --max-seconds 600",  # which nobody can solve
    "table": "table --set SET --solvers secular --accuracy low --jobs 1 --out OUT",
    "reference": "reference SET --out OUT.hdf5 --jobs 1",
    "simulate": "simulate wisp-straight-19-mu0.3 --steps 12 --out OUT --checkpoint-every 1",
    "corpus": "corpus build rods102 --out OUT",
}


def interrupted(arguments, after, code=signal.SIGINT):
    """Run a command, interrupt it so many seconds after Python is up; its exit code and what it said on stderr."""
    environment = os.environ | {"PYTHONPATH": CODE}
    with subprocess.Popen(
        [sys.executable, "-c", READY, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    ) as process:
        assert process.stdout.readline() == "ready\n"
        time.sleep(after)
        process.send_signal(code)
        _, said = process.communicate(timeout=300)
    return process.returncode, said


STAGES = [
    *(
        ("solve", signal.SIGINT, after) for after in (0.0, 0.4)
    ),  # while modules load, which is the same for all
    *((command, signal.SIGINT, 1.5) for command in LONG),
    *((command, signal.SIGTERM, 2.0) for command in ("table", "simulate")),
]


@pytest.mark.parametrize(("command", "code", "after"), STAGES)
def test_an_interruption_is_a_sentence_at_every_stage(tmp_path, command, code, after):
    (tmp_path / "set").mkdir()
    for seed in range(3):
        write(tmp_path / "set" / f"{seed}.hdf5", strands(seed, contacts=200, rods=20))
    write(tmp_path / "walls.hdf5", walls())
    places = {"WALLS": tmp_path / "walls.hdf5", "SET": tmp_path / "set"}
    arguments = [str(places.get(a, a)).replace("OUT", str(tmp_path / "out")) for a in LONG[command].split()]
    returncode, said = interrupted(arguments, after, code)
    assert "Traceback" not in said, said
    assert (returncode == 0 and command != "solve") or "interrupted" in said, (returncode, said)
    assert returncode in (0, 130) or after == 0, (returncode, said)


@pytest.mark.parametrize("code", [signal.SIGINT, signal.SIGTERM])
def test_an_interruption_when_all_is_done_changes_nothing(tmp_path, code):
    done = child("-c", LATE.format(code=int(code)), "solvers")
    assert (done.returncode, done.stderr) == (0, "")
    assert "secular" in done.stdout


def test_machine_code_is_made_without_interruption():
    """An interruption inside would be lost, or crash; it comes when the code is there."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a process in the background has none
    done = []

    def make(library):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)  # the interpreter would have looked by now
        done.append(library)

    try:
        with pytest.raises(KeyboardInterrupt):
            jit._finalize("code", make)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert done == ["code"]
