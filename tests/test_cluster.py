"""Runs and references on a Dask cluster of worker processes on the loopback: same rows, whatever dies."""

import os
import signal

import pytest
from listeners import Silent
from test_bench_run import method, plan_for, plugin, write_set
from typer.testing import CliRunner

from fibercontact.bench.problem_set import load_set
from fibercontact.bench.protocol import BenchError
from fibercontact.bench.references import find_references
from fibercontact.bench.rows import RowFile, but_for_clocks
from fibercontact.bench.run import run
from fibercontact.cli import app
from fibercontact.reference.ground_truth import Search
from fibercontact.reference.store import references_file

distributed = pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cluster")
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        dashboard_address=":0",
        local_directory=str(folder),
        silence_logs=50,
    ) as cluster:
        yield cluster


def told(rows):
    """Rows but for their clocks, in an order of their own."""
    return sorted((but_for_clocks(row) for row in rows), key=lambda row: (row["problem"], row["solver"]))


class Killing(Silent):
    """Kills a worker of the cluster: the first that is at work when a row arrives."""

    def __init__(self, address):
        super().__init__()
        self.address, self.killed = address, []

    def row(self, unit, row):
        if not self.killed:
            with distributed.Client(self.address, set_as_default=False) as client:
                busy = [worker for worker, tasks in client.processing().items() if tasks]
                self.killed = list(client.run(os.getpid, workers=busy[:1]).values()) if busy else []
            for process in self.killed:
                os.kill(process, signal.SIGKILL)


@pytest.fixture
def plan(tmp_path):
    plugins = [plugin(tmp_path, "giving_up"), method(tmp_path, "raises")]
    solvers = ["secular", "hybrid", "giving-up", "raises", "spg"]
    return plan_for(write_set(tmp_path / "set", 6), solvers, plugins, timed=(), rates=("mid",), jobs=2)


def test_rows_are_those_of_a_local_run_even_when_a_worker_dies(cluster, plan, tmp_path):
    here, there = RowFile(tmp_path / "here"), RowFile(tmp_path / "there")
    assert run(plan, here, Silent()) == []
    killing = Killing(cluster.scheduler_address)
    assert run(plan, there, killing, cluster.scheduler_address) == []
    assert len(killing.killed) == 1
    assert len(there.read()) == 6 * 5
    assert told(there.read()) == told(here.read())
    assert {row["reason"] for row in there.read()} == {"", "local", "crash"}


def test_a_cluster_that_adapts_starts_workers_for_a_run(tmp_path):
    plan = plan_for(write_set(tmp_path / "set", 2), ["secular"], timed=(), rates=("low",))
    rows = RowFile(tmp_path / "run")
    with distributed.LocalCluster(
        n_workers=0,
        threads_per_worker=1,
        host="127.0.0.1",
        dashboard_address=":0",
        local_directory=str(tmp_path),
        silence_logs=50,
    ) as cluster:
        cluster.adapt(minimum=0, maximum=1)
        assert run(plan, rows, Silent(), cluster.scheduler_address) == []
    assert len(rows.read()) == 2


def test_what_cannot_be_read_and_what_ends_its_process_cost_no_more_than_themselves(cluster, tmp_path):
    """The plugin needs a module beside it, which travels with it."""
    path = method(tmp_path, "dies")
    (tmp_path / "neighbour.py").write_text("CODE = 7")
    text = path.read_text().replace("import os", "import os\nfrom neighbour import CODE")
    path.write_text(text.replace("os._exit(3)", "os._exit(CODE)"))
    folder, rows = write_set(tmp_path / "set", 2), RowFile(tmp_path / "run")
    (folder / "chain-00.hdf5").write_bytes(b"not HDF5")
    plan = plan_for(folder, ["dies", "secular"], [path], timed=(), rates=("mid",))
    (fault,) = run(plan, rows, Silent(), cluster.scheduler_address)
    assert fault.startswith(str(folder / "chain-00.hdf5"))
    assert [(row["problem"], row["reason"], row["detail"]) for row in rows.read()] == [
        ("chain-01", "crash", "the process ended with code 7"),
        ("chain-01", "", ""),
    ]


def test_bytes_that_are_not_the_problem_s_are_refused(cluster, tmp_path):
    folder = write_set(tmp_path / "set", 2)
    plan = plan_for(folder, ["secular"], timed=(), rates=("low",))
    (folder / "chain-00.hdf5").write_bytes(b"changed since the set was looked at")
    with pytest.raises(BenchError, match=r"got chain-00.hdf5 with the hash [0-9a-f]+, not"):
        run(plan, RowFile(tmp_path / "run"), Silent(), cluster.scheduler_address)


def test_references_are_found_there_and_kept_here(cluster, tmp_path):
    entries, search = load_set(write_set(tmp_path / "set", 2)), Search(max_seconds=4.0, starts=1)
    heard = []
    file = references_file(tmp_path / "set")
    rows, faults = find_references(entries, file, search, 1, heard.append, cluster.scheduler_address)
    assert faults == []
    assert [row["problem"] for row in rows] == [entry.name for entry in entries]
    assert sorted(row["problem"] for row in heard) == [row["problem"] for row in rows]
    again, _ = find_references(entries, file, search, 1, heard.append)
    assert again == rows  # stored, the seconds too


# The command line


def call(*arguments):
    return CliRunner().invoke(app, list(map(str, arguments)))


def test_a_run_begun_here_goes_on_there_and_is_timed_here(cluster, tmp_path):
    common = (
        "table",
        "--set",
        write_set(tmp_path / "set", 2),
        "--solvers",
        "secular",
        "--out",
        tmp_path / "run",
    )
    rows, found = RowFile(tmp_path / "run"), []
    for options in (
        ("--rates", "low", "--limit", 1),
        ("--dask", cluster.scheduler_address),
        ("--accuracy", "low"),
        ("--dask", cluster.scheduler_address),
    ):
        result = call(*common, *options)
        assert result.exit_code == 0, result.output
        found.append([(row["problem"], row["mode"]) for row in rows.read()])
    here, there = [("chain-00", "rates")], [("chain-01", "rates")]
    timed = [("chain-00", "timed"), ("chain-01", "timed")]
    assert found == [here, here + there, here + there + timed, here + there + timed]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--accuracy", "low"], "times are not taken on a cluster"),
        (["--log", "visits"], "visits are not logged on a cluster"),
        (["--level", "1"], "belong to level 3"),
    ],
)
def test_what_is_not_done_on_a_cluster_is_refused(tmp_path, options, said):
    result = call("table", "--set", write_set(tmp_path / "set", 1), "--dask", "tcp://127.0.0.1:1", *options)
    assert result.exit_code == 2
    assert said in result.stderr


def test_no_scheduler_is_an_error_of_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr("fibercontact.bench.cluster.CONNECT_SECONDS", 0.5)
    folder = write_set(tmp_path / "set", 1)
    arguments = ("--solvers", "secular", "--out", tmp_path / "run", "--dask", "tcp://127.0.0.1:1")
    result = call("table", "--set", folder, *arguments)
    assert result.exit_code == 2
    assert "error: no Dask scheduler at tcp://127.0.0.1:1" in result.stderr
