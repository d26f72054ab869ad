"""Threads over ranges of rods, segments or contacts, and threads that wait for each other.

Kernels run without the interpreter's lock (see `jit`). What is done for a range depends on that range only, so the
results are the same, bit for bit, for any number of threads.
"""

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import TypeVar

__all__ = ["over_ranges", "thread_count", "together"]

Result = TypeVar("Result")


def thread_count() -> int:
    """Threads that are used: `FIBERCONTACT_THREADS`, or the cores that this process may run on."""
    asked = os.environ.get("FIBERCONTACT_THREADS", "")
    if asked.isdecimal() and int(asked) > 0:
        return int(asked)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def over_ranges(function: Callable[[int, int], Result], count: int, size: int) -> list[Result]:
    """Call `function(first, end)` for ranges of at most `size` that make up 0..count; the results in order.

    >>> over_ranges(lambda first, end: (first, end), 5, 2)
    [(0, 2), (2, 4), (4, 5)]
    """
    firsts = range(0, count, size)
    ends = [min(first + size, count) for first in firsts]
    threads = min(thread_count(), len(ends))
    if threads <= 1:
        return list(map(function, firsts, ends))
    return list(_pool(os.getpid(), threads).map(function, firsts, ends))


@cache
def _pool(process: int, threads: int) -> ThreadPoolExecutor:
    """The threads of this process: a fork has none of its parent's."""
    return ThreadPoolExecutor(threads)


def together(functions: Sequence[Callable[[], Result]]) -> list[Result]:
    """Call the functions, each in a thread of its own so that they can wait for each other; the results in order.

    An error in one of them is raised when all have ended.
    """
    if len(functions) == 1:
        return [functions[0]()]
    results: dict[int, Result] = {}
    faults: list[BaseException] = []

    def run(k: int) -> None:
        try:
            results[k] = functions[k]()
        except BaseException as fault:
            faults.append(fault)

    threads = [threading.Thread(target=run, args=(k,), daemon=True) for k in range(len(functions))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if faults:
        raise faults[0]
    return [results[k] for k in range(len(functions))]
