"""The machine and the versions that a row was measured with."""

import os
import platform
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import fibercontact

__all__ = [
    "MEMORY_SHARE", "ONE_THREAD", "cpu_model", "load", "memory_share", "one_thread", "usable_cores", "versions"
]  # fmt: skip

ONE_THREAD = dict.fromkeys(
    (
        "FIBERCONTACT_THREADS",
        "NUMBA_NUM_THREADS",
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
    ),
    "1",
)
"""Environment variables of a process that is to use one thread."""

MEMORY_SHARE = 0.75
"""Of the machine's memory, for all worker processes together."""


@cache
def cpu_model() -> str:
    """Name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


@cache
def versions() -> Mapping[str, str]:
    """Versions of what the numbers depend on."""
    found = {"fibercontact": fibercontact.__version__, "python": platform.python_version()}
    for package in ("numpy", "numba", "scipy"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "unknown"
    return found


def load() -> float:
    """Number of other processes that run at this moment, NaN where the system does not tell.

    Not the mean over the last minute, which would count what this run itself did in parallel before.
    """
    try:
        running = Path("/proc/loadavg").read_text(encoding="utf-8").split()[3].partition("/")[0]
    except (OSError, IndexError):
        return float("nan")
    return max(0.0, float(running) - 1.0)


def usable_cores() -> list[int]:
    """Numbers of the cores that this process may run on."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def memory_share(processes: int = 1) -> int:
    """Bytes that each of so many worker processes may use by default: together three quarters of the memory.

    That of the machine, or what a container of this process is allowed.
    """
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    try:
        allowed = int(Path("/sys/fs/cgroup/memory.max").read_text(encoding="utf-8"))
    except (OSError, ValueError):  # not there, or "max"
        allowed = memory
    return int(MEMORY_SHARE * min(memory, allowed) / processes)


@contextmanager
def one_thread() -> Iterator[None]:
    """What runs inside, and processes started there, use one thread, in numba and BLAS too."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
