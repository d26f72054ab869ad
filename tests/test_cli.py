"""The command line: what it prints, writes and returns."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.sparse import csr_array, eye_array
from typer.testing import CliRunner

import fibercontact
from fibercontact.cli import app
from fibercontact.cli.options import split_solvers
from fibercontact.problem.fclib import Solution, read, write
from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.problem.measure import measure
from fibercontact.problem.step import StepProblem

PLUGIN = '''"""Frictionless contact: an example.

Solves `u_N = 0` alone.
"""
from fibercontact.jit import jit
from fibercontact.local.contract import LocalSolver, Option, Status

@jit
def kernel(W, b, mu, r, options):
    return Status.CONVERGED, (max(0.0, -options[0] * b[0] / W[0][0]), 0.0, 0.0), 1

solver = LocalSolver(kernel, options={"relaxation": Option(1.0, "share of the step that is taken")})
'''

KNOWN = "dac, enum-companion, enum-quartic, hybrid, mfb, pac, pyramid, secular"


def stack(contacts=3, mu=0.4):
    """Unit masses one on another, pushed down and aside; the lowest on the ground."""
    H = csr_array(np.kron((eye_array(contacts) - eye_array(contacts, k=-1)).toarray(), np.eye(3)))
    f = np.tile([1.0, 0.1, -0.2], contacts)
    return StepProblem(
        eye_array(3 * contacts, format="csr"), f, H, np.zeros(3 * contacts), np.full(contacts, mu)
    )


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "stack.hdf5"
    write(path, stack(), title="Three masses", guesses=[Solution(r=np.zeros(9))])
    return path


def call(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def fails(*arguments):
    """Call what must fail by one line and exit code 2; returns the line."""
    result = call(*arguments)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr.count("\n") == 1
    assert result.stderr.startswith("error: ")
    return result.stderr


@pytest.mark.parametrize("arguments", [["--help"], ["table", "--help"], ["solve", "-h"], ["--version"]])
def test_help_imports_nothing_heavy(arguments):
    environment = os.environ | {"PYTHONPATH": str(Path(fibercontact.__file__).parents[1])}
    result = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "fibercontact", *arguments],
        env=environment, capture_output=True, text=True, check=True,
    )  # fmt: skip
    imported = {line.rpartition("|")[2].strip().partition(".")[0] for line in result.stderr.splitlines()}
    assert "typer" in imported
    assert not imported & {"numba", "numpy", "scipy", "pandas", "matplotlib", "h5py"}
    assert "fibercontact" in result.stdout


def test_version():
    assert call("--version").stdout == f"fibercontact {fibercontact.__version__}\n"


# solve


def test_solve_prints_and_writes_an_answer_that_measures_as_said(file, tmp_path):
    out = tmp_path / "answer.hdf5"
    result = call("solve", file, "--solver", "hybrid", "--accuracy", "high", "--out", out, "--json")
    assert result.exit_code == 0
    said = json.loads(result.stdout)
    answer = read(out)
    problem, solution = answer.problem.condense(), answer.solution
    found = measure(problem, solution.r)
    assert said["solved"]
    assert said["residual"] == pytest.approx(found.residual)
    assert found.residual <= said["tolerance"] == 1e-6
    np.testing.assert_allclose(solution.u, problem.W @ solution.r + problem.b, atol=1e-12)
    step = stack()
    np.testing.assert_allclose(step.M @ solution.v + step.f, step.H.T @ solution.r, atol=1e-12)
    assert answer.title == "Three masses"
    assert len(answer.guesses) == 1


def test_solve_an_incremental_problem(tmp_path):
    problem = IncrementalProblem.from_sparse(
        eye_array(6), np.array([-1.0, 0.1, 0, 1, 0, 0]), np.array([0.5, 0.5])
    )
    write(tmp_path / "local.hdf5", problem)
    out = tmp_path / "answer.hdf5"
    assert call("solve", tmp_path / "local.hdf5", "--solver", "secular", "--out", out).exit_code == 0
    np.testing.assert_allclose(read(out).solution.r, [1.0, -0.1, 0, 0, 0, 0], atol=1e-9)  # stick, take-off


def test_solve_from_the_answer_takes_no_sweep(file, tmp_path):
    out = tmp_path / "answer.hdf5"
    call("solve", file, "--solver", "hybrid", "--accuracy", "full", "--out", out)
    answer = read(out)
    write(tmp_path / "again.hdf5", answer.problem, guesses=[answer.solution])
    result = call("solve", tmp_path / "again.hdf5", "--solver", "hybrid", "--start", "guess", "--json")
    assert json.loads(result.stdout)["sweeps"] == 0


def test_accelerated_outer_loop_solves_to_full_accuracy(file):
    result = call(
        "solve", file, "--solver", "secular", "--outer", "accelerated", "--accuracy", "full", "--json"
    )
    assert result.exit_code == 0
    assert json.loads(result.stdout)["residual"] <= 1e-8


def test_exit_code_tells_an_answer_that_misses_the_tolerance(file):
    result = call("solve", file, "--solver", "secular", "--accuracy", "full", "--max-sweeps", 1)
    assert result.exit_code == 1
    assert "not solved (outer" in result.stdout


def test_the_input_is_never_overwritten(file):
    before = file.read_bytes()
    detour = file.parent / ".." / file.parent.name / file.name
    assert "is the problem itself" in fails("solve", file, "--solver", "secular", "--out", detour)
    assert file.read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--solver", "nix"], "unknown solver 'nix' (known: admm, apgd, "),
        (["--solver", "pyramid:sides=3"], "unknown option 'sides' (known: facets"),
        (["--solver", "pyramid:facets=2"], "'facets' must be an integer >= 3"),
        (["--solver", "pac", "--accuracy", "best"], "unknown accuracy 'best' (known: low, mid, high, full)"),
        (["--solver", "pac", "--start", "warm"], "unknown start 'warm' (known: cold, guess)"),
        (
            ["--solver", "pac", "--outer", "fast"],
            "unknown outer loop 'fast' (known: plain, accelerated, robust)",
        ),
        (["--solver", "pac", "--plugin", "nowhere.py"], "nowhere.py: no such file"),
        (["--solver", "pac", "--out", "no/such/folder/a.hdf5"], "no such folder"),
    ],
)
def test_errors_of_solve(file, arguments, message):
    assert message in fails("solve", file, *arguments)


def test_no_guess_is_an_error(tmp_path):
    write(tmp_path / "bare.hdf5", stack())
    assert "no guess" in fails("solve", tmp_path / "bare.hdf5", "--solver", "pac", "--start", "guess")


@pytest.mark.parametrize("command", [["info"], ["solve", "--solver", "pac"]])
def test_bad_files_are_errors(tmp_path, command):
    (tmp_path / "text.hdf5").write_text("not HDF5")
    assert "text.hdf5: not a readable HDF5 file" in fails(*command, tmp_path / "text.hdf5")
    assert "absent.hdf5: no such file" in fails(*command, tmp_path / "absent.hdf5")
    assert "is a directory" in fails(*command, tmp_path)


def test_a_wrong_option_is_an_error_of_usage():
    assert call("solve", "--no-such-option").exit_code == 2


def test_solve_by_a_global_method(file, tmp_path):
    out = tmp_path / "answer.hdf5"
    result = call("solve", file, "--solver", "newton-ac", "--accuracy", "full", "--out", out, "--json")
    assert result.exit_code == 0
    said = json.loads(result.stdout)
    answer = read(out)
    assert measure(answer.problem.condense(), answer.solution.r).residual <= 1e-8
    assert 0 < said["sweeps"] < 50
    short = call("solve", file, "--solver", "spg", "--accuracy", "full", "--max-sweeps", 1)
    assert short.exit_code == 1
    assert "not solved (iterations: the iterations were exhausted)" in short.stdout
    assert "there are no visits to log" in fails("solve", file, "--solver", "spg", "--log", "visits")


# info and solvers


def test_info_describes_the_problem(file):
    lines = dict(
        line.split(maxsplit=1) for line in call("info", file).stdout.splitlines() if " of " not in line
    )
    assert lines["contacts"] == "3"
    assert lines["mu"] == "0.4 to 0.4"
    assert lines["title"] == "Three masses"
    # W_11 = I, W_22 = W_33 = 2 I; blocks 2 + 3 + 2; b = -H f has the norm of f on the first contact only
    assert lines["blocks"] == "a row          2.3"
    assert float(lines["b_ref"].split()[0]) == pytest.approx(np.sqrt(1.05 / 3), rel=1e-2)
    text = call("info", file).stdout
    assert "rank of W             9 of 9" in text
    assert "degrees of freedom    9" in text
    assert "condition of W_ii     1 to 1" in text
    assert f"guess 1             residual {measure(stack().condense(), np.zeros(9)).residual:.2e}" in text


def test_solvers_lists_names_laws_options_and_origins(tmp_path):
    (tmp_path / "my_solver.py").write_text(PLUGIN)
    text = call("solvers", "--plugin", tmp_path / "my_solver.py").stdout
    for name in KNOWN.split(", "):
        assert f"\n{name}  (" in f"\n{text}"
    assert "pyramid  (pyramid with 4 facets; built in)" in text
    assert f"my-solver  (Coulomb; {tmp_path / 'my_solver.py'})\n    Frictionless contact: an example." in text
    assert "    relaxation=1  share of the step that is taken" in text
    assert text.index("\nmy-solver  (") < text.index(
        "\nspg  (global method; Coulomb; built in)\n    Spectral"
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("pac", ["pac"]),
        ("pac, mfb,", ["pac", "mfb"]),
        ("mfb:tolerance=1,max_iterations=2,pac", ["mfb:tolerance=1,max_iterations=2", "pac"]),
        ("pyramid:facets=4,pyramid:facets=8,pac,pac", ["pyramid:facets=4", "pyramid:facets=8", "pac"]),
    ],
)
def test_lists_of_solvers(text, expected):
    assert split_solvers(text) == expected


# table


def test_table_with_a_plugin(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "set").mkdir()
    for n in (2, 3):
        write(tmp_path / "set" / f"stack-{n}.hdf5", stack(n))
    (tmp_path / "my_solver.py").write_text(PLUGIN)
    result = call("table", "--set", "set", "--solvers", "pyramid:facets=8,hybrid", "--plugin", "my_solver.py",
                  "--rates", "high", "--accuracy", "low", "--max-sweeps", 300, "--jobs", 2)  # fmt: skip
    assert result.exit_code == 0, result.stderr
    table = pd.read_csv(tmp_path / "runs" / "set" / "table.csv").set_index("solver")
    assert list(table.index) == ["pyramid:facets=8", "hybrid", "my-solver"]
    assert table["failure_percent"].tolist() == [0.0, 0.0, 100.0]  # without friction the law is missed
    assert table.loc["my-solver", "reasons"] == "outer 2"
    assert table.loc["hybrid", "time_geo_ms"] > 0
    assert table["failure_percent_high"].tolist() == [0.0, 0.0, 100.0]
    assert "my-solver" in result.stdout
    for name in (
        "table.md",
        "table.tex",
        "rows.csv",
        "strata.csv",
        "profile.svg",
        "failures.png",
        "environment.json",
    ):
        assert (tmp_path / "runs" / "set" / name).stat().st_size > 0

    fresh = call("table", "--set", "set", "--solvers", "hybrid", "--limit", 1, "--rates", "low", "--fresh")
    assert fresh.exit_code == 0
    assert "is in runs/set.1 now" in fresh.stdout
    rows = (tmp_path / "runs" / "set" / "rows.jsonl").read_text().splitlines()
    assert [json.loads(row)["solver"] for row in rows] == ["hybrid"]


def test_table_of_global_methods(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "set").mkdir()
    write(tmp_path / "set" / "stack.hdf5", stack())
    assert call("new-solver", "mine", "--global").exit_code == 0
    result = call("table", "--set", "set", "--solvers", "secular", "--global", "--plugin", "mine.py",
                  "--rates", "high")  # fmt: skip
    assert result.exit_code == 0, result.stderr
    table = pd.read_csv(tmp_path / "runs" / "set" / "table.csv").set_index("solver")
    methods = ["admm", "apgd", "cadoux-apgd", "cadoux-spg", "interior-point", "newton-ac", "newton-fb", "spg"]
    assert list(table.index) == ["secular", *methods, "mine"]
    assert (table["failed"] == 0).all()
    assert "global methods, whose sweeps are iterations" in result.stdout
    assert "global outer loop" not in result.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--level", 1, "--global"], "--global belong to level 3"),
        (["--level", 1, "--solvers", "spg"], "unknown local solver 'spg'"),
        (["--set", "nowhere"], "no set of problems 'nowhere'"),
        (["--accuracy", "best"], "unknown accuracy 'best'"),
        (["--rates", "best"], "unknown accuracy 'best'"),
        (["--set", "SET", "--solvers", "hybrid,nix"], "unknown solver 'nix'"),
        (["--set", "SET", "--plugin", "nowhere.py"], "nowhere.py: no such file"),
    ],
)
def test_errors_of_table(file, arguments, message):
    arguments = [str(file.parent) if a == "SET" else a for a in arguments]
    assert message in fails("table", *arguments)


@pytest.mark.parametrize("seconds", ["inf", "nan", "1e7", "-1"])
@pytest.mark.parametrize(
    "command", [["table", "--set"], ["solve", "--solver", "pac"], ["explain", "--out", "x"]]
)
def test_seconds_are_a_number_that_a_clock_can_hold(file, command, seconds):
    """An infinite limit cannot be a row's, nor a timer's."""
    result = call(*command, file, "--max-seconds", seconds)
    assert result.exit_code == 2
    assert "--max-seconds" in result.stderr


# simulate and dump


def test_simulate_runs_some_steps_and_leaves_rows_and_a_picture(tmp_path):
    out = tmp_path / "run"
    result = call("simulate", "wisp-straight-19-mu0.3", "--steps", "3", "--out", out)
    assert result.exit_code == 0, result.output
    assert "3 steps" in result.output
    assert len((out / "steps.csv").read_text().splitlines()) == 4
    assert (out / "last.png").read_bytes().startswith(b"\x89PNG")


def test_scenes_are_listed_and_unknown_ones_refused(tmp_path):
    assert "comb-curly-91-mu1" in call("simulate", "list").output
    out = tmp_path / "run"
    assert "unknown scene 'nowhere' (known: wisp-straight" in fails("simulate", "nowhere", "--out", str(out))
    assert not out.exists()


def test_a_new_scene_gives_its_own_problems_and_they_solve(tmp_path):
    file, out = tmp_path / "mine.toml", tmp_path / "run"
    assert "simulate" in call("new-scene", file).output
    asked = ["simulate", file, "--steps", "41", "--dump", "every=20", "--min-contacts", "100", "--out", out]
    result = call(*asked)
    assert result.exit_code == 0, result.output
    rows = (out / "steps.csv").read_text().splitlines()[1:]
    expected = [k for k in (0, 20, 40) if int(rows[k].split(",")[2]) >= 100]
    listed = (out / "problems" / "manifest.csv").read_text().splitlines()[1:]
    assert [line.split(",")[0] for line in listed] == [f"mine-{k:03d}.hdf5" for k in expected]
    assert f"wrote {len(expected)} problems" in result.output
    assert (
        call(
            "solve",
            out / "problems" / f"mine-{expected[-1]:03d}.hdf5",
            "--solver",
            "secular",
            "--accuracy",
            "low",
        ).exit_code
        == 0
    )
    assert "has problems already" in fails(*map(str, asked))
    assert "File exists" in fails("new-scene", str(file))
    assert "ends in .toml" in fails("new-scene", str(tmp_path / "mine.txt"))


@pytest.mark.parametrize("dump", ["10", "every=0", "every=x", "every=-1"])
def test_what_is_dumped_is_every_so_manieth_step(dump):
    assert f"--dump {dump}: write every=K" in fails("simulate", "wisp-straight-19-mu0.3", "--dump", dump)


def test_sets_are_listed_and_unknown_ones_refused():
    assert "core306    306 problems" in call("corpus", "list").output
    assert "unknown set 'core' (known: core306" in fails("corpus", "build", "core")
