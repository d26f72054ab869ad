"""Ground truth for whole sets: in processes, stored as it comes, as a table and on the command line."""

from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from oracles import residual, strands, walls
from typer.testing import CliRunner

from fibercontact.bench import references
from fibercontact.bench.problem_set import limited, load_set
from fibercontact.bench.reference_desk import describe
from fibercontact.bench.references import (
    find_references,
    reference_frame,
    reference_notes,
    summary,
)
from fibercontact.bench.worker import Worker
from fibercontact.cli import app
from fibercontact.problem.fclib import read, write
from fibercontact.problem.incremental import IncrementalProblem
from fibercontact.reference.ground_truth import Search, ground_truth
from fibercontact.reference.store import Store, references_file

SEARCH = Search(max_seconds=4.0, starts=1)


@pytest.fixture
def folder(tmp_path):
    """Two problems with a solution and one without."""
    folder = solvable(tmp_path / "my set", 2)
    write(folder / "squeezed.hdf5", walls())
    return folder


def solvable(folder, count):
    """A set of problems that take little time."""
    folder.mkdir()
    for seed in range(1, count + 1):
        write(folder / f"strands{seed}.hdf5", strands(seed))
    return folder


def no_one(row):
    pass


def test_a_set_is_worked_through_and_a_second_run_computes_nothing(folder):
    file = references_file(folder)
    rows, faults = find_references(load_set(folder), file, SEARCH, 2, no_one)
    assert file == folder.parent / "my set.references.hdf5"
    assert [row["problem"] for row in rows] == ["squeezed", "strands1", "strands2"]
    assert [row["existence"] for row in rows] == ["unsolvable", "solvable", "solvable"]
    assert [row["reference"] == "none" for row in rows] == [True, False, False]
    assert faults == []
    assert sorted(path.name for path in folder.iterdir()) == [
        "squeezed.hdf5",
        "strands1.hdf5",
        "strands2.hdf5",
    ]
    again, _ = find_references(load_set(folder), file, SEARCH, 1, no_one)
    assert again == rows  # the seconds, too: they were stored


def test_a_proved_unsolvable_problem_is_marked_in_its_set_if_the_proof_holds(folder):
    """Tables leave these out of the failure rate."""
    store = Store(references_file(folder))
    for entry in load_set(folder):
        store.find(entry.hash, entry.name, read(entry.file).problem, SEARCH)
    store.pack()
    assert [entry.existence for entry in load_set(folder)] == ["unsolvable", "", ""]
    with h5py.File(references_file(folder), "r+") as file:
        file[load_set(folder)[0].hash]["certificate"][:] = 0.0
    assert [entry.existence for entry in load_set(folder)] == ["", "", ""]


@pytest.fixture
def workers(monkeypatch):
    """The workers of a run, as they are made."""
    made = []

    class Known(Worker):
        def __init__(self, setting):
            super().__init__(setting)
            made.append(self)

    monkeypatch.setattr(references, "Worker", Known)
    return made


def test_an_interruption_loses_nothing_and_leaves_no_process(tmp_path, workers):
    folder, processes = solvable(tmp_path / "set", 3), []

    def interrupt(row):
        processes.extend(worker._process for worker in workers)
        raise KeyboardInterrupt

    file = references_file(folder)
    with pytest.raises(KeyboardInterrupt):
        find_references(load_set(folder), file, SEARCH, 1, interrupt)
    assert processes
    assert all(process.poll() is not None for process in processes)
    assert not file.exists()
    assert len(list(Store(file).parts.glob("*.hdf5"))) >= 1
    rows, _ = find_references(load_set(folder), file, SEARCH, 1, no_one)
    assert len(rows) == 3
    assert file.exists()
    assert not Store(file).parts.exists()


def test_a_process_that_dies_costs_its_problem_and_says_so(tmp_path, workers, monkeypatch):
    folder = solvable(tmp_path / "set", 3)
    ask, asked = Worker.ask, []

    def dying(self, name, arguments, limit):
        asked.append(name)
        if len(asked) == 2:
            self._process.kill()
        return ask(self, name, arguments, limit)

    monkeypatch.setattr(Worker, "ask", dying)
    rows, (fault,) = find_references(load_set(folder), references_file(folder), SEARCH, 1, no_one)
    assert len(rows) == 2
    assert "the process died of SIGKILL" in fault
    assert fault.startswith(str(folder))
    assert find_references(load_set(folder), references_file(folder), SEARCH, 1, no_one)[1] == []


# The table


def test_a_row_says_what_convexity_costs():
    """A contact that slides, alone: it dissipates `mu r_N u_T`, and lifts off at `mu ‖u_T‖` when convexified."""
    problem = IncrementalProblem.from_sparse(np.eye(3), np.array([-1.0, 3.0, 0.0]), np.array([0.5]))
    row = describe(problem, ground_truth(problem, SEARCH))
    r_N = (1.0 + 0.5 * 3.0) / (1.0 + 0.25)  # of the convexified law: `r ⟂ u`, both on their cones
    u_N, u_T = r_N - 1.0, 3.0 - 0.5 * r_N
    assert u_N == pytest.approx(0.5 * u_T)
    assert row["friction_work"] == pytest.approx(0.5 * 1.0 * 2.5, rel=1e-6)
    assert row["associated_friction_work"] == pytest.approx(0.5 * r_N * u_T, rel=1e-6)
    assert row["associated_lift_off"] == pytest.approx(u_N / np.sqrt(10.0), rel=1e-6)
    assert row["associated_velocity_error"] == pytest.approx(
        np.hypot(r_N - 1.0, 0.5 * (r_N - 1.0)) / np.hypot(1.0, 0.5), rel=1e-6
    )
    assert (row["existence"], row["solutions"]) == ("solvable", 1)


def test_summary_and_notes_hide_nothing():
    rows = [
        {"scene": "a", "problem": "a1"} | describe(strands(1), ground_truth(strands(1), SEARCH)),
        {"scene": "a", "problem": "a2"} | describe(walls(), ground_truth(walls(), SEARCH)),
        {"scene": "b", "problem": "b1", "contacts": 3, "existence": "undecided", "reference": "sweeps",
         "residual": 1e-12, "starts": 2, "solutions": 3, "distance": 0.7, "associated_gap": 1e-11},
    ]  # fmt: skip
    frame = reference_frame(rows)
    table = summary(frame).set_index("scene")
    assert table.loc["a", "solution exists: yes / no / ?"] == "1 / 1 / 0"
    assert table.loc["all", "solution exists: yes / no / ?"] == "1 / 1 / 1"
    assert list(table["references"]) == ["1", "1", "2"]
    assert list(table["several solutions"]) == ["0", "1", "1"]
    said = "\n".join(reference_notes(frame))
    for text in (
        "1 of 1 solvable",
        "b1 (0.7)",
        "unsolvable: a2",
        "undecided: b1",
        "no reference (best known only): a2",
    ):
        assert text in said


# The command


def invoke(*arguments):
    return CliRunner().invoke(app, ["reference", *map(str, arguments)])


def test_the_command_prints_the_table_and_goes_on_after_a_broken_file(folder):
    (folder / "broken.hdf5").write_bytes(b"not HDF5")
    result = invoke(folder, "--jobs", 1, "--max-seconds", 4, "--starts", 1)
    assert result.exit_code == 2
    assert "broken.hdf5" in result.stderr
    assert "2 of 2 solvable problems have a reference" in result.output
    frame = pd.read_csv(folder.with_name("my set.references.csv"))
    assert list(frame["problem"]) == ["squeezed", "strands1", "strands2"]


def test_an_unknown_set_is_an_error_of_one_line():
    result = invoke("nowhere")
    assert result.exit_code == 2
    assert "no set of problems 'nowhere'" in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1


def test_references_that_cannot_be_read_are_an_error_of_one_line(folder):
    references_file(folder).write_bytes(b"not HDF5")
    result = invoke(folder, "--jobs", 1)
    assert result.exit_code == 2
    assert "my set.references.hdf5: not a readable HDF5 file" in result.stderr


# What is committed

CORE306 = Path(__file__).parents[1] / "problems" / "core306"


@pytest.mark.parametrize("entry", limited(load_set(CORE306), 12), ids=lambda entry: entry.name)
def test_the_committed_references_hold_for_the_problems_as_they_are(entry):
    """Residual and certificate are computed anew; the residual by the tests' own definition, too."""
    problem = read(entry.file).problem
    found = Store(references_file(CORE306)).get(entry.hash, problem, Search())
    assert found.reference.accepted
    assert (found.existence.verdict, found.existence.margin > 0.0) == ("solvable", True)
    assert found.gap <= 1e-10
    if problem.n <= 100:
        incremental = problem.condense()
        W = incremental.W.toarray()
        for r in (found.reference.r, *found.uniqueness.others):
            assert residual(W, incremental.b, incremental.mu, r) <= 1.01e-10
