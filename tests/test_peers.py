"""Peers' processes: messages, faults of all kinds, units, and the real ones where they are installed."""

import io
import json
import math
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import oracles
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from typer.testing import CliRunner

from fibercontact.cli import app
from fibercontact.errors import UserError
from fibercontact.gauss_seidel.blocks import block_system
from fibercontact.gauss_seidel.solver import GaussSeidel
from fibercontact.global_methods.contract import Task, Unsuited
from fibercontact.local.registry import configure, registered
from fibercontact.peers import method as method_module
from fibercontact.peers.catalogue import PEERS, SOLVERS, specifications
from fibercontact.peers.child import CHILDREN, Child, Died, Faulty, Late
from fibercontact.peers.children.serve import Garbled, message, receive
from fibercontact.peers.method import blocks_of, peer_method, units_of
from fibercontact.peers.peer import Missing, Peer
from fibercontact.problem.fclib import Solution, read, write
from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.problem.measure import measure

# Messages

texts = st.text(max_size=8)
numbers = st.one_of(st.integers(-(2**60), 2**60), st.floats(allow_nan=False), st.booleans(), texts)
fields = st.dictionaries(texts, st.one_of(numbers, st.lists(numbers, max_size=3)), max_size=4)
names = st.sampled_from(["r", "start", "blocks", "b"])
shapes = arrays.array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=4)
values = st.one_of(arrays.arrays(np.float64, shapes), arrays.arrays(np.int32, shapes))
contents = st.tuples(fields, st.dictionaries(names, values, max_size=3))


@settings(max_examples=50)
@given(st.lists(contents, max_size=3))
def test_messages_come_through_a_pipe_as_they_were(sent):
    pipe = io.BytesIO(b"".join(message(*content) for content in sent))
    for known, data in sent:
        fields, found = receive(pipe.read)
        assert fields == known
        assert found.keys() == data.keys()
        for name, value in data.items():
            np.testing.assert_array_equal(found[name], value, strict=True)
    with pytest.raises(EOFError):
        receive(pipe.read)


@settings(max_examples=50)
@given(contents, st.floats(0, 1, exclude_max=True))
def test_a_message_cut_short_is_the_end(content, share):
    whole = message(*content)
    with pytest.raises(EOFError):
        receive(io.BytesIO(whole[: int(share * len(whole))]).read)


@settings(max_examples=50)
@given(contents, st.binary(min_size=4, max_size=40))
def test_garbage_is_no_message(content, garbage):
    whole = message(*content)
    if not garbage.startswith(whole[:4]):
        with pytest.raises(Garbled):
            receive(io.BytesIO(garbage + whole).read)
    with pytest.raises(Garbled):
        receive(io.BytesIO(whole[:12] + bytes(len(whole) - 12)).read)


# Processes of fake peers

DESK = """
import os, signal, sys, time
import numpy as np

class Desk:
    version = "1.0"

    def lay_out(self, starts, columns, blocks, b, mu):
        {lay_out}
        return b

    def solve(self, problem, order, start):
        found = {{"claimed": True, "iterations": 3, "error": 1e-12, "seconds": 0.25, "note": "done"}}
        r = np.zeros_like(start)
        if len(r) == 6 and not order.get("early"):
            return found, r  # the small problem that warms up
        {solve}
        return found, r
"""

FAKES = {
    "zero": "",
    "echo": "r = start",
    "noise": "print('noise' * 1000); os.write(1, b'noise' * 1000); os.write(2, b'noise' * 1000); r = start",
    "hangs": "time.sleep(60.0)",
    "spins": "while True: pass",
    "alarms": "os.kill(os.getpid(), signal.SIGALRM)",
    "crashes": "os.write(2, b'an assertion failed'); os.kill(os.getpid(), signal.SIGSEGV)",
    "exits": "os._exit(3)",
    "raises": "raise RuntimeError('no pivot')",
    "nan": "r = np.full_like(start, np.nan)",
    "short": "r = r[:-1]",
}


def desk(folder, solve="", lay_out=""):
    path = folder / "desk.py"
    path.write_text(DESK.format(solve=solve or "pass", lay_out=lay_out or "pass"))
    return path


@pytest.fixture
def fake(tmp_path, monkeypatch):
    """Makes a fake peer; its processes are ended afterwards."""
    sessions = {}
    monkeypatch.setattr(method_module, "_sessions", sessions)

    def make(solve="", lay_out=""):
        return Peer(
            "fake", desk(tmp_path, solve, lay_out), "FIBERCONTACT_FAKE_PYTHON", (sys.executable,), "-"
        )

    yield make
    for session in sessions.values():
        session.child.end()


@pytest.fixture
def child(tmp_path):
    """Makes a process of a fake desk."""
    started = []

    def start(**how):
        started.append(Child(sys.executable, desk(tmp_path, **how)))
        return started[-1]

    yield start
    for process in started:
        process.end()


def problem(seed=0, contacts=5, unit=1.0):
    """Contacts with a well-conditioned W, pushed together at random."""
    rng = np.random.default_rng(seed)
    W = unit * (np.eye(3 * contacts) + 0.1 * oracles.definite(rng, 10.0, 3 * contacts))
    return IncrementalProblem.from_sparse(W, rng.normal(size=3 * contacts), rng.uniform(0.1, 0.9, contacts))


def ask(peer, given=None, start=None, seconds=2.0, **options):
    given = given or problem()
    method = peer_method(peer, {"solver": "ANY"}, {})
    task = Task(1e-6, given.b_ref, 100, seconds, start)
    return method.solve(block_system(given), task, method.option_values(options))


def test_the_account_of_a_peer_is_passed_on(fake):
    answer = ask(fake(FAKES["zero"]))
    assert (answer.claimed, answer.iterations, answer.seconds, answer.note) == (True, 3, 0.25, "done")
    assert answer.residual == 1e-12
    assert measure(problem(), answer.r).residual > 0.1  # whatever it claims


@pytest.mark.parametrize("name", ["echo", "noise"])
@pytest.mark.parametrize("scaled", [0, 1])
@pytest.mark.parametrize("unit", [1.0, 3e5])
def test_impulses_come_back_in_the_units_they_were_sent_in(fake, name, scaled, unit):
    given = problem(unit=unit)
    start = np.random.default_rng(1).normal(size=15) / unit
    np.testing.assert_array_equal(ask(fake(FAKES[name]), given, start, scaled=scaled).r, start)


@pytest.mark.parametrize(("margin", "asked"), [(1.0, 1e-6), (10.0, 1e-7), (0.5, 2e-6)])
def test_a_margin_divides_the_tolerance_that_a_peer_gets(fake, margin, asked):
    peer = fake("r = np.full_like(start, order['tolerance'])")
    np.testing.assert_allclose(ask(peer, scaled=0, margin=margin).r, asked, rtol=1e-14)


@pytest.mark.parametrize("margin", [0.0, -1.0])
def test_a_margin_must_be_positive(fake, margin):
    with pytest.raises(UserError, match="margin must be positive"):
        ask(fake(), margin=margin)


@given(st.integers(0, 99), st.integers(1, 6), st.floats(-300.0, 300.0))
def test_a_problem_is_handed_over_to_the_last_bit(seed, contacts, exponent):
    given = problem(seed, contacts, 2.0**exponent)
    system = block_system(given)
    units = units_of(system, given.b_ref)
    handed = method_module._handed_over(system, units)
    np.testing.assert_array_equal(blocks_of(system), given.W.data)
    np.testing.assert_array_equal(handed["blocks"] * units.W, given.W.data)
    np.testing.assert_array_equal(handed["b"] * units.b, given.b)
    size = np.trace(handed["blocks"][system.columns == np.repeat(np.arange(contacts), contacts)].mean(0)) / 3
    assert 0.7 < size < 1.42


@pytest.mark.parametrize("name", ["hangs", "spins", "alarms"])
def test_a_peer_that_hangs_is_killed_and_the_next_solve_has_a_new_one(fake, name, monkeypatch):
    monkeypatch.setattr(method_module, "ANSWER_SECONDS", 0.3)
    peer = fake(FAKES[name])
    began = time.monotonic()
    for _ in range(2):
        answer = ask(peer, seconds=0.2)
        assert not answer.claimed
        assert answer.seconds == 0.2
        assert "killed" in answer.note
        assert not answer.r.any()
        assert method_module._sessions == {}
    assert time.monotonic() - began < 20.0


@pytest.mark.parametrize(
    ("name", "fault", "words"),
    [
        ("crashes", Died, "SIGSEGV: an assertion failed"),
        ("exits", Died, "ended with code 3"),
        ("raises", Faulty, "RuntimeError: no pivot"),
        ("short", Faulty, r"shape \(14,\)"),
    ],
)
def test_a_peer_that_fails_says_how_and_can_be_asked_again(fake, name, fault, words):
    peer = fake(FAKES[name])
    for _ in range(2):
        with pytest.raises(fault, match=words):
            ask(peer)


def test_the_last_words_are_those_of_the_request_that_it_died_of(fake):
    peer = fake(FAKES["crashes"], lay_out="os.write(2, b'all is well ' * 99)")
    with pytest.raises(Died, match=r"^its process died of SIGSEGV: an assertion failed$"):
        ask(peer)


def test_an_interruption_leaves_no_answer_behind_for_the_next_question(fake, monkeypatch):
    peer, read = fake(FAKES["echo"]), Child._read
    ask(
        peer
    )  # from here on there is a process: `warm` and `solve` are asked, each answer is read in two pieces
    pieces = iter([read, read, interrupted])
    monkeypatch.setattr(Child, "_read", lambda self, count: next(pieces)(self, count))
    with pytest.raises(KeyboardInterrupt):
        ask(peer, start=np.full(15, 1.0))
    monkeypatch.setattr(Child, "_read", read)
    np.testing.assert_array_equal(ask(peer, start=np.full(15, 2.0)).r, 2.0)


def interrupted(*_):
    raise KeyboardInterrupt


def test_impulses_that_are_not_numbers_come_through_to_be_judged(fake):
    assert math.isinf(measure(problem(), ask(fake(FAKES["nan"])).r).residual)


def test_a_problem_that_a_peer_does_not_take_is_unsuited(fake):
    peer = fake(lay_out="if len(mu) > 2: raise ValueError('too many contacts')")
    for _ in range(2):
        with pytest.raises(Unsuited, match=r"^too many contacts$"):
            ask(peer)


def test_a_problem_without_contacts_needs_no_peer():
    peer = Peer("none", CHILDREN / "none.py", "FIBERCONTACT_NONE_PYTHON", (), "-")
    nothing = IncrementalProblem.from_sparse(np.zeros((0, 0)), np.zeros(0), np.zeros(0))
    answer = ask(peer, nothing)
    assert answer.claimed
    assert answer.r.shape == (0,)


def test_a_new_problem_gets_a_new_process_and_the_old_one_ends(fake):
    peer, found = fake(FAKES["zero"]), []
    method = peer_method(peer, {"solver": "ANY"}, {})
    for seed in (0, 1):
        for _ in range(2):
            method.solve(block_system(problem(seed)), Task(1e-6, 1.0, 100, 2.0), method.option_values({}))
            found.append(method_module._sessions[peer, True].child._process)
    assert found[0] is found[1]
    assert found[2] is found[3]
    assert found[0].poll() is not None
    assert found[2].poll() is None


def test_what_a_process_prints_is_no_answer(child):
    process = child(solve=FAKES["noise"])
    process.ask("load", method_module._handed_over(block_system(problem()), method_module.Units(1, 1)), 5.0)
    fields, found = process.ask("solve", {"start": np.arange(15.0)}, 5.0)
    assert fields["iterations"] == 3
    np.testing.assert_array_equal(found["r"], np.arange(15.0))


def test_a_python_that_talks_nonsense_is_told_from_one_that_dies(tmp_path):
    python = tmp_path / "python"
    for script, words in (
        ("echo hello world", "no message"),
        ("kill -9 $$", "SIGKILL"),
        ("exit 7", "code 7"),
    ):
        python.write_text(f"#!/bin/sh\n{script}\n")
        python.chmod(0o755)
        with pytest.raises(Died, match=words):
            Child(str(python), desk(tmp_path))


def test_nonsense_after_the_greeting_ends_the_process(tmp_path):
    script = f"""
        import sys
        sys.path.insert(0, {str(CHILDREN)!r})
        import serve
        sys.stdout.buffer.write(serve.message({{"version": "1"}}, {{}}) + b"Segmentation violation")
        sys.stdout.flush()
        sys.stdin.read()
    """
    (tmp_path / "fake.py").write_text(textwrap.dedent(script))
    python = tmp_path / "python"
    python.write_text(f"#!/bin/sh\nexec {sys.executable} {tmp_path}/fake.py\n")
    python.chmod(0o755)
    process = Child(str(python), tmp_path)
    with pytest.raises(Died, match="no message"):
        process.ask("load", {}, 5.0)
    assert process._process.poll() is not None


def test_a_request_that_nobody_reads_is_late(tmp_path):
    python = tmp_path / "python"
    code = f"import sys; sys.path.insert(0, {str(CHILDREN)!r}); import serve, time; "
    code += "sys.stdout.buffer.write(serve.message({'version': '1'}, {})); sys.stdout.flush(); time.sleep(60)"
    python.write_text(f'#!/bin/sh\nexec {sys.executable} -c "{code}"\n')
    python.chmod(0o755)
    process = Child(str(python), tmp_path)
    with pytest.raises(Late, match="killed"):
        process.ask("load", {"blocks": np.zeros(10**6)}, 0.3)


def test_a_process_does_not_outlive_its_parent(tmp_path):
    parent = f"""
        import sys, numpy as np
        from pathlib import Path
        from fibercontact.peers.child import Child
        child = Child(sys.executable, Path({str(desk(tmp_path, solve=FAKES["hangs"]))!r}))
        child.ask("load", {{"starts": 0, "columns": 0, "blocks": 0, "b": np.zeros(9), "mu": 0}}, 5.0)
        print(child._process.pid, flush=True)
        child.ask("solve", {{"start": np.zeros(9)}}, 60.0)
    """
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(parent)], stdout=subprocess.PIPE, text=True
    )
    pid = int(process.stdout.readline())
    time.sleep(0.3)  # it is in the solve
    os.kill(pid, 0)
    process.kill()
    process.wait()
    process.stdout.close()
    for _ in range(100 if sys.platform == "linux" else 700):
        if not alive(pid):
            return
        time.sleep(0.1)
    os.kill(pid, signal.SIGKILL)
    pytest.fail("the peer's process lives on")


def alive(pid):
    """Whether a process runs; one that is only not yet buried does not."""
    try:
        os.kill(pid, 0)
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (ProcessLookupError, FileNotFoundError):
        return False


# Finding a peer


def test_a_missing_peer_says_how_to_install_it(tmp_path, monkeypatch):
    peer = Peer("rare", desk(tmp_path), "FIBERCONTACT_RARE_PYTHON", (), "apt install rare")
    with pytest.raises(Missing) as plain:
        peer.find()
    assert str(plain.value) == (
        "rare is not here: apt install rare, or name a Python that has it in FIBERCONTACT_RARE_PYTHON"
    )
    monkeypatch.setenv("FIBERCONTACT_RARE_PYTHON", sys.executable)
    assert peer.find().version == "1.0"
    assert peer.find().python == sys.executable
    (tmp_path / "text").write_text("no program")
    (tmp_path / "text").chmod(0o755)
    for place, words in (("nowhere", ""), ("text", r" \(.*: it cannot be run: .*\)")):
        monkeypatch.setenv("FIBERCONTACT_RARE_PYTHON", str(tmp_path / place))
        with pytest.raises(Missing, match=rf"^rare is not in .*{place}{words}: apt install rare"):
            peer.find()


def test_a_python_without_the_peer_says_what_it_lacks(tmp_path, monkeypatch):
    file = tmp_path / "desk.py"
    file.write_text("import no_such_peer")
    monkeypatch.setenv("FIBERCONTACT_RARE_PYTHON", sys.executable)
    with pytest.raises(Missing, match="No module named 'no_such_peer'"):
        Peer("rare", file, "FIBERCONTACT_RARE_PYTHON", (), "apt install rare").find()


# The real ones, where they are installed


def installed():
    for name, peer in PEERS.items():
        try:
            peer.find()
        except Missing:
            continue
        yield name


HERE = list(installed())
REAL = [name for name, solver in SOLVERS.items() if solver.peer.name in HERE]


@pytest.fixture(scope="module", autouse=True)
def _no_process_left():
    yield
    for session in method_module._sessions.values():
        session.child.end()
    method_module._sessions.clear()


@pytest.mark.parametrize("scaled", [0, 1])
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("name", REAL)
def test_on_kind_problems_peers_find_our_velocity(name, seed, scaled):
    given = problem(seed)
    ours = GaussSeidel(configure("secular", registered()), tolerance=1e-11).solve(given).r
    method = SOLVERS[name].method()
    task = Task(1e-9, given.b_ref, 5000, 20.0)
    answer = method.solve(block_system(given), task, method.option_values({"scaled": scaled}))
    assert answer.claimed
    assert answer.seconds > 0.0
    assert measure(given, answer.r).residual < 1e-7
    np.testing.assert_allclose(given.W @ answer.r, given.W @ ours, atol=1e-6)


@pytest.mark.parametrize("name", REAL)
def test_the_limit_on_iterations_is_the_peers_own(name):
    given = problem(3, contacts=30)
    method = SOLVERS[name].method()
    answer = method.solve(block_system(given), Task(1e-12, given.b_ref, 2, 20.0), method.option_values({}))
    assert answer.iterations <= 3


@pytest.mark.parametrize("name", HERE)
def test_a_solution_is_a_start_that_peers_keep(name):
    given = problem(2)
    ours = GaussSeidel(configure("secular", registered()), tolerance=1e-12).solve(given).r
    solver = next(solver for solver in SOLVERS.values() if solver.peer.name == name)
    method = solver.method()
    answer = method.solve(
        block_system(given), Task(1e-6, given.b_ref, 50, 20.0, ours), method.option_values({})
    )
    assert answer.claimed
    assert answer.iterations <= 2
    assert measure(given, answer.r).residual < 1e-6


# Rows


FATES = {"NSN_AC": FAKES["crashes"], "NSN_FB": FAKES["hangs"], "NSN_NM": FAKES["zero"]}
"""What the solvers of a fake Siconos do; the others give back their start."""


def table(folder, *arguments):
    found = CliRunner().invoke(app, ["table", "--set", str(folder / "set"), "--out", str(folder / "run"),
                                     "--accuracy", "mid", "--jobs", "1", *arguments])  # fmt: skip
    file = folder / "run" / "rows.jsonl"
    rows = [json.loads(line) for line in file.read_text().splitlines()] if file.is_file() else []
    return found, {row["solver"]: row for row in rows if row["mode"] == "timed"}


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    """The rows of a table with all solvers of a fake Siconos, which starts from the answer."""
    folder = tmp_path_factory.mktemp("fates")
    (folder / "set").mkdir()
    answer = GaussSeidel(configure("secular", registered()), tolerance=1e-8).solve(problem()).r
    write(folder / "set" / "one.hdf5", problem(), guesses=[Solution(r=answer)])
    fates = (
        f"if order['solver'] == {solver!r}: {fate or 'return found, r'}" for solver, fate in FATES.items()
    )
    fake = desk(folder, "\n        ".join([*fates, "r = start"]))
    python = folder / "python"
    python.write_text(f"#!/bin/sh\nexec {sys.executable} {CHILDREN / 'serve.py'} {fake}\n")
    python.chmod(0o755)
    with pytest.MonkeyPatch.context() as patch:  # found by the environment variable, as a worker would
        patch.setenv("FIBERCONTACT_SICONOS_PYTHON", str(python))
        found, rows = table(folder, "--solvers", "secular", "--peers", "siconos", "--start", "guess",
                            "--max-seconds", "0.5")  # fmt: skip
    assert found.exit_code == 0, found.output
    return rows


@pytest.mark.parametrize(
    ("name", "reason", "claimed"),
    [
        ("siconos-nsn-nm", "false success", True),
        ("siconos-nsn-ac", "crash", False),
        ("siconos-nsn-fb", "time", False),
        ("siconos-prox", "", True),
    ],
)
def test_what_becomes_of_a_peer_is_a_row(rows, name, reason, claimed):
    row = rows[name]
    assert (row["reason"], row["claimed"], row["solved"]) == (reason, claimed, not reason)
    assert row["fingerprint"].startswith("siconos 1.0 ")
    assert row.get("own_residual") == (1e-12 if claimed else None)
    if reason == "crash":
        assert row["detail"] == "its process died of SIGSEGV: an assertion failed"


def test_the_time_of_a_peer_is_by_its_own_clock(rows):
    assert rows["siconos-prox"]["time_median"] == 0.25
    assert rows["siconos-prox"]["sweeps"] == 3


def test_all_solvers_of_a_peer_are_rows_and_harm_no_other(rows):
    assert set(rows) == {"secular", *specifications("siconos")}
    assert {"siconos-nsgs", "siconos-nsgs:full=1", "siconos-prox"} < set(rows)
    unsolved = {name for name, row in rows.items() if not row["solved"]}
    assert unsolved == {"siconos-nsn-ac", "siconos-nsn-fb", "siconos-nsn-nm"}


def test_peers_that_are_missing_are_skipped_with_a_line(tmp_path, monkeypatch):
    (tmp_path / "set").mkdir()
    write(tmp_path / "set" / "one.hdf5", problem())
    for name in ("SICONOS", "PINOCCHIO"):
        monkeypatch.setenv(f"FIBERCONTACT_{name}_PYTHON", str(tmp_path / "nowhere"))
    found, rows = table(tmp_path, "--solvers", "secular", "--peers", "siconos,pinocchio")
    assert found.exit_code == 0
    assert list(rows) == ["secular"]
    lines = [line for line in found.output.splitlines() if line.startswith("skipped: ")]
    assert len(lines) == 2
    assert "apt install python3-siconos" in lines[0]
    assert "pip install pin" in lines[1]
    found, _ = table(tmp_path, "--solvers", "siconos-prox")
    assert found.exit_code == 2
    assert "apt install python3-siconos" in found.output


def test_an_unknown_peer_is_refused_with_those_that_are_known(tmp_path):
    (tmp_path / "set").mkdir()
    write(tmp_path / "set" / "one.hdf5", problem())
    found, _ = table(tmp_path, "--peers", "bullet")
    assert found.exit_code == 2
    assert "unknown peer 'bullet' (known: siconos, pinocchio)" in found.output


@pytest.mark.parametrize("name", HERE)
def test_the_verdict_on_a_real_peer_is_the_measure_of_its_answer(tmp_path, name):
    given = problem(4)
    write(tmp_path / "one.hdf5", given)
    solver = next(s.name for s in SOLVERS.values() if s.peer.name == name)
    answer = tmp_path / "answer.hdf5"
    found = CliRunner().invoke(app, ["solve", str(tmp_path / "one.hdf5"), "--solver", solver, "--json",
                                     "--out", str(answer)])  # fmt: skip
    said = json.loads(found.output)
    assert found.exit_code == 0
    assert said["residual"] == measure(given, read(answer).solution.r).residual
    assert said["residual"] <= said["tolerance"]


def test_peers_are_listed_whether_they_are_here_or_not(monkeypatch):
    for name in ("SICONOS", "PINOCCHIO"):
        monkeypatch.setenv(f"FIBERCONTACT_{name}_PYTHON", "nowhere")
    output = CliRunner().invoke(app, ["solvers"]).output
    for solver in SOLVERS.values():
        assert f"{solver.name}  (global method; Coulomb; peer: {solver.peer.name})" in output
