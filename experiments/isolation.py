"""What it costs that solvers run in a process of their own: milliseconds a problem, beside the same passes within.

    python experiments/isolation.py --limit 40

Each problem is taken and solved by one pass a solver, by a desk in this process and by one in a worker's. Also: what
a new process costs after one was lost, and what it costs to write a row.
"""

import argparse
import statistics
import tempfile
import time
from pathlib import Path

from fibercontact.bench.environment import one_thread
from fibercontact.bench.passes import Desk, Pass
from fibercontact.bench.problem_set import find_set, limited, load_set
from fibercontact.bench.protocol import Limits
from fibercontact.bench.rows import RowFile
from fibercontact.bench.worker import Setting, Worker
from fibercontact.global_methods.registry import configure, registered


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--set", default="core306", help="a set of problems")
    parser.add_argument("--limit", type=int, default=40, help="problems, spread over the set")
    parser.add_argument("--solvers", default="secular,hybrid", help="one pass each")
    parser.add_argument("--repetitions", type=int, default=3, help="the fastest of so many counts")
    return parser.parse_args()


def seconds_of(load, solve, file, labels, repetitions):
    """Of taking a problem and of a pass with each solver; the fastest of several times."""
    times = []
    for _ in range(repetitions):
        began = time.perf_counter()
        load(file, "cold")
        for label in labels:
            solve(file, Pass(label, "low", "plain", Limits(), timed=True))
        times.append(time.perf_counter() - began)
    return min(times)


def main():
    options = arguments()
    labels, known = options.solvers.split(","), registered()
    with one_thread():
        desk = Desk([], labels)
    prints = {label: configure(label, known).registered.fingerprint for label in labels}
    worker = Worker(Setting((), prints))
    files = [entry.file for entry in limited(load_set(find_set(options.set)), options.limit)]
    began = time.perf_counter()
    worker.load(files[0], "cold")
    start = time.perf_counter() - began
    extra = []
    for file in files:
        within = seconds_of(desk.load, lambda _, task: desk.solve(task), file, labels, options.repetitions)
        apart = seconds_of(
            worker.load,
            lambda file, task: worker.solve(file, "cold", task, 60.0),
            file,
            labels,
            options.repetitions,
        )
        extra.append(1e3 * (apart - within))
    worker.end()
    requests = 1 + len(labels)
    print(f"{len(files)} problems, {len(labels)} passes each: {requests} requests to the process a problem")
    print(f"a problem costs {statistics.median(extra):.2f} ms more in a process of its own (median)")
    print(f"a request to a process that has nothing to do: {1e3 * empty_request(prints):.3f} ms")
    print(f"a new process: {start:.1f} s")
    print(f"a row on the disk: {1e3 * row_seconds():.2f} ms")


def empty_request(prints):
    """Seconds of asking for what takes no time: the best hundred of a thousand."""
    worker = Worker(Setting((), prints))
    worker.ask("fingerprints", (), 600.0)
    times = []
    for _ in range(10):
        began = time.perf_counter()
        for _ in range(100):
            worker.ask("fingerprints", (), 60.0)
        times.append((time.perf_counter() - began) / 100)
    worker.end()
    return min(times)


def row_seconds():
    """Seconds of appending a row."""
    with tempfile.TemporaryDirectory(dir=".") as folder:
        rows = RowFile(Path(folder))
        with rows.appending():
            began = time.perf_counter()
            for number in range(100):
                rows.append({"number": number, "text": 1500 * "x"})
            return (time.perf_counter() - began) / 100


if __name__ == "__main__":
    main()
