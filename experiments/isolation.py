"""What it costs that solvers run in a process of their own: milliseconds a problem, beside the same passes within.

Each problem is taken and solved by one pass a solver, by a desk in this process and by one in a worker's. Also: what
a new process costs after one was lost, and what it costs to write a row.

    python experiments/isolation.py [--set core306] [--limit 40] [--solvers secular,hybrid] [--repetitions 3]
"""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from common.script import fastest, options

from fibercontact.bench.environment import one_thread
from fibercontact.bench.passes import Desk, Pass
from fibercontact.bench.problem_set import find_set, limited, load_set
from fibercontact.bench.protocol import Limits
from fibercontact.bench.rows import RowFile
from fibercontact.bench.worker import Setting, Worker
from fibercontact.global_methods.registry import configure, registered


def seconds_of(
    load: Callable[[Path, str], object],
    solve: Callable[[Path, Pass], object],
    file: Path,
    labels: Sequence[str],
    repetitions: int,
) -> float:
    """Of taking a problem and of a pass with each solver; the fastest of several times."""

    def passes() -> None:
        load(file, "cold")
        for label in labels:
            solve(file, Pass(label, "low", "plain", Limits(), timed=True))

    return fastest(passes, repetitions)


def empty_request(prints: Mapping[str, str]) -> float:
    """Seconds of asking for what takes no time: the best hundred of a thousand."""
    worker = Worker(Setting((), prints))
    worker.ask("fingerprints", (), 600.0)
    seconds = fastest(lambda: [worker.ask("fingerprints", (), 60.0) for _ in range(100)], 10)
    worker.end()
    return seconds / 100


def row_seconds() -> float:
    """Seconds of appending a row."""
    with tempfile.TemporaryDirectory(dir=".") as folder:
        rows = RowFile(Path(folder))
        row = {"text": 1500 * "x"}
        with rows.appending():
            return fastest(lambda: [rows.append({"number": k} | row) for k in range(100)], 1) / 100


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--set", default="core306", help="a set of problems")
    parser.add_argument("--limit", type=int, default=40, help="problems, spread over the set")
    parser.add_argument("--solvers", default="secular,hybrid", help="one pass each")
    parser.add_argument("--repetitions", type=int, default=3, help="the fastest of so many counts")
    given = parser.parse_args()
    labels, known = given.solvers.split(","), registered()
    with one_thread():
        desk = Desk([], labels)
    prints = {label: configure(label, known).registered.fingerprint for label in labels}
    worker = Worker(Setting((), prints))
    files = [entry.file for entry in limited(load_set(find_set(given.set)), given.limit)]
    start = fastest(lambda: worker.load(files[0], "cold"), 1)
    ways = (
        (desk.load, lambda _, task: desk.solve(task)),
        (worker.load, lambda file, task: worker.solve(file, "cold", task, 60.0)),
    )
    times = np.array([[seconds_of(*way, file, labels, given.repetitions) for way in ways] for file in files])
    worker.end()
    requests = 1 + len(labels)
    print(f"{len(files)} problems, {len(labels)} passes each: {requests} requests to the process a problem")
    print(f"a problem costs {1e3 * np.median(np.diff(times)):.2f} ms more in a process of its own (median)")
    print(f"a request to a process that has nothing to do: {1e3 * empty_request(prints):.3f} ms")
    print(f"a new process: {start:.1f} s")
    print(f"a row on the disk: {1e3 * row_seconds():.2f} ms")


if __name__ == "__main__":
    main()
