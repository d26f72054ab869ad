"""The memory that a problem asks for, looked at before it is allocated: a small file can ask for any amount."""

import os
import sys

from fibercontact.problem.incremental import ProblemError

__all__ = ["check_memory"]


def check_memory(what: str, values: int) -> None:
    """Raise `ProblemError` when `what`, of so many float64 values, is more than the machine or a limit allows."""
    if 8 * values > _allowed():
        raise ProblemError(f"{what} needs {8 * values / 2**30:.3g} GiB: more memory than there is")


def _allowed() -> float:
    """Bytes that this process may use at most, as far as the system tells."""
    if sys.platform == "win32":
        return float("inf")
    import resource

    limits = (resource.getrlimit(kind)[0] for kind in (resource.RLIMIT_AS, resource.RLIMIT_DATA))
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return min([memory, *(limit for limit in limits if limit != resource.RLIM_INFINITY)])
