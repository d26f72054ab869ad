"""Speed, as ratios measured in one run: of solvers and peers, threads, sweeps, against n, and from a start.

Solvers take turns on a problem and the least of several runs counts, pinned to one core but where threads are
compared; every answer is measured by the harness. Peers run in processes of their own, by their own clocks, where
they are installed. The problems are the assemblies of `assemblies.py` and FCLIB files named by `--files`. Writes one
table a study and two figures. Times want a machine that does nothing else.

    python experiments/speed.py [--peers siconos] [--files FOLDER] [--most 100000] [--out results/speed]
"""

import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pandas as pd
from assemblies import strands
from common.script import fastest, options, write_table
from matplotlib.figure import Figure
from scipy import stats

from fibercontact.bench.environment import cpu_model, one_thread, usable_cores
from fibercontact.bench.figures import COLOURS, MARKERS, save
from fibercontact.bench.passes import Laid, gauss_seidel, lay_out, solve_globally
from fibercontact.bench.protocol import Limits
from fibercontact.errors import UserError
from fibercontact.gauss_seidel.anderson import Acceleration
from fibercontact.gauss_seidel.blocks import new_velocity, write_velocity
from fibercontact.gauss_seidel.solver import GaussSeidel
from fibercontact.gauss_seidel.team import alone
from fibercontact.local.registry import Configured
from fibercontact.peers.catalogue import PEERS, specifications
from fibercontact.peers.peer import Missing
from fibercontact.peers.registry import configure, registered
from fibercontact.problem.fclib import read
from fibercontact.problem.measure import measure

LIMITS = Limits(20_000, 5.0)
YARDSTICKS = ((1000, 0.3, 3), (5000, 0.3, 4), (200, 1.0, 2), (1000, 1.0, 3))
OURS = ("secular plain", "secular accelerated", "secular robust", "apgd", "spg")
SIZES = (200, 500, 1000, 2000, 5000, 10_000, 30_000, 100_000)
LEVELS = tuple(10.0**-k for k in np.arange(1.0, 8.1, 0.5))
FILES = ("Capsules-i100-889", "OneObject-i100000-316", "BoxesStack1-i100000-32")
IMPORT = "import time; t = time.perf_counter(); import fibercontact; print(time.perf_counter() - t)"
FIRST = """
import time
began = time.perf_counter()
import numpy as np
from fibercontact.gauss_seidel.solver import GaussSeidel
from fibercontact.local.registry import configure, registered
from fibercontact.problem.incremental import IncrementalProblem
problem = IncrementalProblem.from_sparse(np.eye(9), np.tile([-1.0, 0.5, 0.0], 3), np.full(3, 0.3))
GaussSeidel(configure("secular", registered())).solve(problem)
print(time.perf_counter() - began)
"""


@contextmanager
def pinned() -> Iterator[None]:
    """On one core, with one thread."""
    cores = usable_cores()
    with one_thread():
        os.sched_setaffinity(0, {cores[-1]})
        try:
            yield
        finally:
            os.sched_setaffinity(0, cores)


def solver(name: str) -> Callable[[Laid, float], dict[str, float]]:
    """How to solve by `SOLVER [LOOP]`, once: seconds, residual by our measure, sweeps or iterations."""
    specification, _, loop = name.partition(" ")
    chosen = configure(specification, registered())
    chosen.kernel() if isinstance(chosen, Configured) else chosen.prepare()

    def local(laid: Laid, tolerance: float) -> dict[str, float]:
        run = gauss_seidel(chosen, tolerance, loop, LIMITS).solve_system(laid.system, laid.problem.b_ref)
        found = measure(laid.problem, run.r).residual
        return {"seconds": run.seconds, "residual": found, "sweeps": run.sweeps}

    def whole(laid: Laid, tolerance: float) -> dict[str, float]:
        try:
            row = solve_globally(chosen, laid, None, tolerance, LIMITS)
        except UserError as reason:  # a peer that dies or raises
            print(f"{name}: {reason}", file=sys.stderr)
            row = {}
        return {name: row.get(name, np.nan) for name in ("seconds", "residual", "sweeps")}

    return local if isinstance(chosen, Configured) else whole


def race(laid: Laid, names: Sequence[str], tolerance: float, repetitions: int) -> list[dict[str, object]]:
    """The solvers in turns; the least time of each, and its ratio to the first's."""
    solve = {name: solver(name) for name in names}
    rows: dict[str, dict[str, object]] = {}
    for turn in range(repetitions):
        for name in names:
            before = rows.get(name)
            if before and (not before["solved"] or (turn > 1 and before["seconds"] > 2.0)):
                continue  # slow or failed: once is enough
            found = solve[name](laid, tolerance)
            if not before or found["seconds"] < before["seconds"]:
                rows[name] = found | {"solver": name, "solved": found["residual"] <= tolerance}
    unit = next((row["seconds"] for row in rows.values() if row["solved"]), np.nan)
    return [row | {"ratio": row["seconds"] / unit if row["solved"] else np.nan} for row in rows.values()]


def yardsticks(names: Sequence[str], most: int, repetitions: int) -> pd.DataFrame:
    """Assemblies to 2e-5, and to 1e-8."""
    rows = []
    for n, mu, seed in YARDSTICKS:
        if n > most:
            continue
        laid = lay_out(strands(n, mu, seed))
        for tolerance in (2e-5, 1e-8):
            about = {"contacts": n, "mu": mu, "tolerance": tolerance}
            rows += [about | row for row in race(laid, names, tolerance, repetitions)]
    return pd.DataFrame(rows)


def files(folder: Path, names: Sequence[str], repetitions: int) -> pd.DataFrame:
    """Files of other simulators to 1e-8."""
    rows = []
    for name in FILES:
        laid = lay_out(read(folder / f"{name}.hdf5").problem)
        about = {"file": name, "contacts": laid.problem.n, "tolerance": 1e-8}
        rows += [about | row for row in race(laid, names, 1e-8, repetitions)]
    return pd.DataFrame(rows)


def roofline(most: int, repetitions: int) -> pd.DataFrame:
    """A visit that moves its contact, beside the time to read its blocks from memory and to push them."""
    cases = (*YARDSTICKS[:2], *((n, 0.3, 3) for n in SIZES[-2:]))  # the blocks of the last are in no cache
    rows = [row_of_roofline(lay_out(strands(*case)), repetitions) for case in cases if case[0] <= most]
    return pd.DataFrame(rows)


def row_of_roofline(laid: Laid, repetitions: int) -> dict[str, float]:
    """In ns a contact; visits of 40 sweeps, their local solves included."""
    system, parts, n = laid.system, laid.system.parts, laid.problem.n
    r, u, team = np.ones(3 * n), new_velocity(parts), alone(len(parts.parts) - 1)
    chosen = configure("secular", registered())
    assert isinstance(chosen, Configured)
    never = Acceleration(sweeps=1000, window=2)
    sweeps = GaussSeidel(chosen, 0.0, 40, 30.0, 40, 0.0, never, negligible=0.0, rescue_after=0)
    visits = sweeps.solve_system(system, laid.problem.b_ref).visits
    asked = visits.total - visits.left_out
    write_velocity(system, parts, r, team, u)
    reading = fastest(system.blocks.sum, 10 * repetitions) / n
    pushing = fastest(lambda: write_velocity(system, parts, r, team, u), 10 * repetitions) / n
    visiting = fastest(lambda: sweeps.solve_system(system, laid.problem.b_ref), repetitions) / asked
    with patch("fibercontact.gauss_seidel.solver.LANES", 1):
        one_by_one = fastest(lambda: sweeps.solve_system(system, laid.problem.b_ref), repetitions) / asked
    return {
        "contacts": n,
        "blocks_a_row": len(system.columns) / n,
        "read_ns": 1e9 * reading,
        "push_ns": 1e9 * pushing,
        "moving_visit_ns": 1e9 * visiting,
        "one_by_one_ns": 1e9 * one_by_one,
        "push_over_read": pushing / reading,
        "visit_over_read": visiting / reading,
        "local_iterations": visits.iterations / asked,
    }


def growth(most: int, repetitions: int) -> pd.DataFrame:
    """Cost against n to 1e-4, with one thread and with all, and whether the answers are the same."""
    rows = []
    solve = gauss_seidel(configure("secular", registered()), 1e-4, "robust", LIMITS)
    for n in (size for size in SIZES if size <= most):
        laid = lay_out(strands(n, 0.3, 3))
        cores, times, runs = len(usable_cores()), [], []
        for threads in (1, cores):
            call = lambda: runs.append(solve.solve_system(laid.system, laid.problem.b_ref))  # noqa: B023, E731
            with patch.dict(os.environ, FIBERCONTACT_THREADS=str(threads)):
                times.append(fastest(call, max(2, repetitions if n < 30_000 else 2)))
        rows.append(
            {
                "contacts": n, "one_thread_ms": 1e3 * times[0], "threads": cores, "threads_ms": 1e3 * times[1],
                "gain": times[0] / times[1], "same": bool((runs[0].r == runs[-1].r).all()),
                "sweeps": runs[-1].sweeps, "setup_ms": 1e3 * laid.setup_seconds,
                "residual": measure(laid.problem, runs[-1].r).residual,
                "blocks_MB": laid.system.blocks.nbytes / 1e6,
            }
        )  # fmt: skip
    return pd.DataFrame(rows)


def accuracy(names: Sequence[str], most: int, repetitions: int) -> pd.DataFrame:
    """Time to each accuracy, on an easy assembly and a hard one."""
    rows = []
    for n, mu, seed in (YARDSTICKS[0], YARDSTICKS[3]) if most >= 1000 else YARDSTICKS[2:3]:
        laid, left = lay_out(strands(n, mu, seed)), list(names)
        for level in LEVELS:
            found = race(laid, left, level, repetitions)
            rows += [{"contacts": n, "mu": mu, "tolerance": level} | row for row in found]
            left = [str(row["solver"]) for row in found if row["solved"]]  # what failed is not asked for more
    return pd.DataFrame(rows)


def starts() -> pd.DataFrame:
    """Seconds of an import, and of everything up to a first answer, compiled anew and read from the disk."""
    rows = []
    with tempfile.TemporaryDirectory() as cache:
        environment = os.environ | {"FIBERCONTACT_CACHE": cache}
        for what, code in (("import", IMPORT), ("first answer, cold", FIRST), ("first answer, warm", FIRST)):
            command, times = [sys.executable, "-c", code], []
            for _ in range(1 if "cold" in what else 3):
                done = subprocess.run(command, env=environment, check=True, capture_output=True)
                times.append(float(done.stdout))
            rows.append({"start": what, "seconds": min(times)})
    return pd.DataFrame(rows)


def draw_accuracy(table: pd.DataFrame) -> Figure:
    """Residual asked for against the time that it takes."""
    cases = table.groupby(["contacts", "mu"], sort=False)
    figure = Figure(figsize=(4.6 * len(cases), 3.8), layout="constrained")
    for axes, ((n, mu), case) in zip(np.atleast_1d(figure.subplots(1, len(cases))), cases, strict=True):
        for k, (name, line) in enumerate(case[case.solved].groupby("solver", sort=False)):
            axes.loglog(
                1e3 * line.seconds, line.tolerance, "-", marker=MARKERS[k % len(MARKERS)], markersize=3,
                color=COLOURS[k % len(COLOURS)], label=name,
            )  # fmt: skip
        axes.set(xlabel="ms", ylabel="residual", title=f"{n} contacts, mu = {mu:g}")
        axes.grid(color="0.9")
        axes.legend(fontsize=7)
    return figure


def draw_growth(table: pd.DataFrame) -> Figure:
    """Time against n, for one thread and several."""
    figure = Figure(figsize=(5.0, 3.8), layout="constrained")
    axes = figure.add_subplot()
    for column, label, colour in (
        ("one_thread_ms", "one thread", COLOURS[1]),
        ("threads_ms", f"{table.threads.iloc[0]} threads", COLOURS[2]),
    ):
        law = stats.linregress(np.log(table.contacts), np.log(table[column])) if len(table) > 2 else None
        grows = f", n^{law.slope:.2f}" if law else ""
        axes.loglog(table.contacts, table[column], "-o", markersize=3, color=colour, label=label + grows)
    axes.set(xlabel="contacts", ylabel="ms to 1e-4")
    axes.grid(color="0.9")
    axes.legend()
    return figure


def with_peers(asked: Sequence[str]) -> list[str]:
    """The solvers of the peers that are installed; a line for each that is not."""
    names: list[str] = []
    for peer in asked:
        try:
            PEERS[peer].find()
            names += specifications(peer)
        except Missing as fault:
            print(fault)
    return names


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--peers", default="", help=f"any of {', '.join(PEERS)}")
    parser.add_argument("--files", type=Path, help="folder of FCLIB files")
    parser.add_argument("--most", type=int, default=100_000, help="contacts of the largest assembly")
    parser.add_argument("--repetitions", type=int, default=7)
    parser.add_argument("--out", type=Path, default=Path("results/speed"))
    given = parser.parse_args()
    peers = with_peers(list(filter(None, given.peers.split(","))))
    tables: dict[str, pd.DataFrame] = {"starts": starts()}
    with pinned():
        tables["roofline"] = roofline(given.most, given.repetitions)
        tables["yardsticks"] = yardsticks(OURS, given.most, given.repetitions)
        if peers:
            tables["peers"] = yardsticks([*OURS, *peers], min(given.most, 1000), given.repetitions)
        if given.files:
            tables["files"] = files(given.files, [*OURS, *peers], given.repetitions)
        tables["accuracy"] = accuracy(OURS, given.most, min(3, given.repetitions))
    tables["growth"] = growth(given.most, given.repetitions)
    print(cpu_model())
    for name, table in tables.items():
        print(f"\n{name}")
        write_table(table, given.out / f"{name}.csv")
    save(draw_accuracy(tables["accuracy"]), given.out, "accuracy")
    save(draw_growth(tables["growth"]), given.out, "growth")


if __name__ == "__main__":
    main()
