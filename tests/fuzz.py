"""Damaged files by the thousand: each must give a problem that is one, or an error that names file and fault.

    python tests/fuzz.py 20000         so many damaged files (`make fuzz N=20000`)
    python tests/fuzz.py 4711 4712     those with these numbers

Files are read in processes that say which one they are at: one that dies or hangs has failed. `SECONDS` of processor
time and `bound` bytes of memory beyond those that the process has anyway are what a file may take.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path

SECONDS, WAITING_SECONDS = 10.0, float(os.environ.get("FUZZ_WAITING_SECONDS", 120))
"""Of processor time for a file, and by the clock: a process that waits for ever spends none."""
BASE = 2**26
MOST_PACKED = 1100  # gzip's bytes from one; unpacked values, and as much again for their copies
BATCH = 1000
KINDS = ("read", "refused", "fault")


def bound(size):
    """Memory that a file of that size may take, in bytes: what it can hold unpacked, and a base."""
    return BASE + 2 * MOST_PACKED * size


# In the process that reads


def serve(seeds, numbers):
    """Examine mutants, one line of JSON before each and one after."""
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        os.mkfifo("fifo")
        for number in numbers:
            examine_one(number, seeds, Path(folder, "mutant.hdf5"))


def examine_one(number, seeds, path):
    from mutations import mutant

    clear(path)
    what = mutant(number, seeds, path)
    say(number=number, what=what)
    size = path.stat().st_size if path.is_file() else 0
    before = memory(reset=True)
    limits(SECONDS, WAITING_SECONDS)
    outcome = outcome_of(path)
    limits(0, 0)
    used = memory() - before
    if used > bound(size):
        outcome = {"fault": f"{used / 2**20:.0f} MiB for a file of {size / 2**20:.3f} MiB"}
    say(number=number, what=what, used=used, size=size, **outcome)


def clear(path):
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)


def say(**line):
    print(json.dumps(line), flush=True)


def limits(processor, clock):
    """Let the system end the process beyond these seconds."""
    signal.setitimer(signal.ITIMER_PROF, processor)
    signal.setitimer(signal.ITIMER_REAL, clock)


def memory(reset=False):
    """The most memory that was used since the last reset, in bytes; 0 where the system does not tell."""
    try:
        if reset:
            Path("/proc/self/clear_refs").write_text("5")
        lines = Path("/proc/self/status").read_text().splitlines()
    except OSError:
        return 0
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM"))


def outcome_of(path):
    """What reading a file and condensing its problem comes to: `read`, `refused` or `fault`."""
    from fibercontact.problem.fclib import read
    from fibercontact.problem.incremental import ProblemError, ProblemWarning

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", ProblemWarning)
            file = read(path)
            check(file)
    except ProblemError as error:
        return judged(error, path)
    except BaseException as error:
        return {"fault": f"{type(error).__name__}: {error}"}
    return {"read": f"{type(file.problem).__name__} of {file.problem.n}"}


def judged(error, path):
    """A refusal, if it is a good one: it names the file and the fault, on one line, and is not for want of memory."""
    text, cause = str(error), error
    while cause is not None:
        if isinstance(cause, MemoryError):
            return {"fault": f"out of memory: {text}"}
        cause = cause.__context__
    named = text.startswith(f"{path}: ") and len(text) > len(f"{path}: ")
    return {"refused" if named and "\n" not in text and len(text) < 1000 else "fault": text}


def check(file):
    """Raise an assertion unless a file holds a problem that is one, and claims that fit it."""
    import numpy as np

    from fibercontact.problem.measure import measure

    problem = file.incremental()
    n, W = problem.n, problem.W.toarray()
    assert n > 0
    assert W.shape == (3 * n, 3 * n)
    assert np.isfinite(W).all()
    assert (W == W.T).all()
    assert problem.b.shape == (3 * n,)
    assert problem.mu.shape == (n,)
    assert np.isfinite([*problem.b, *problem.mu, *problem.sigma, problem.b_ref]).all()
    assert (problem.mu >= 0).all()
    assert (problem.sigma > 0).all()
    for claim in (*file.guesses, *([file.solution] if file.solution else [])):
        r = np.zeros(3 * n) if claim.r is None else claim.r
        assert measure(problem, r).residual >= 0


# In the process that asks


def examine(seeds, numbers, show=lambda found, new: None):
    """The outcomes of mutants, in order; one whose process died is a fault, and the rest goes to another process."""
    todo, found = list(numbers), []
    while todo:
        batch = todo[:BATCH]
        command = [sys.executable, __file__, "--serve", *map(str, seeds)]
        done = subprocess.run(
            command,
            input=json.dumps(batch),
            capture_output=True,
            text=True,
            check=False,
            cwd=Path(__file__).parent,
        )
        lines = list(map(json.loads, done.stdout.splitlines()))
        new = [line for line in lines if len(line) > 2]
        if done.returncode and (not lines or len(lines[-1]) > 2):
            raise RuntimeError(done.stderr)  # the fault is ours
        if done.returncode:
            new.append(
                lines[-1] | {"fault": f"the process ended with {done.returncode}: {done.stderr[-500:]}"}
            )
        todo = todo[todo.index(lines[-1]["number"]) + 1 :]
        found += new
        show(found, new)
    return found


def main(arguments):
    from mutations import seed_files

    with tempfile.TemporaryDirectory() as folder:
        seeds = seed_files(Path(folder, "seeds"), given())
        numbers = range(int(arguments[0])) if len(arguments) == 1 else list(map(int, arguments))
        found = examine(seeds, numbers, show)
    return any("fault" in outcome for outcome in found)


def show(found, new):
    """Print the new faults and how far it is."""
    for outcome in new:
        if "fault" in outcome:
            print(json.dumps(outcome), flush=True)
    kinds = [kind for outcome in found for kind in KINDS if kind in outcome]
    print(", ".join(f"{kinds.count(kind)} {kind}" for kind in KINDS), file=sys.stderr)


def given():
    """Small files of the checkout and of a neighbouring collection, if they are there."""
    root = Path(__file__).parents[1]
    files = [
        *(root / "problems" / "core306").glob("*.hdf5"),
        *(root.parent / "shared" / "fclib").glob("*.hdf5"),
    ]
    return [
        file
        for file in sorted(files, key=lambda f: (f.stat().st_size, f.name))
        if file.stat().st_size < 70_000
    ]


if __name__ == "__main__":
    if sys.argv[1] == "--serve":
        serve(sys.argv[2:], json.load(sys.stdin))
    else:
        sys.exit(main(sys.argv[1:]))
