"""Worker processes that may hang, crash or run out of memory without taking the run with them."""

import importlib
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import warnings
from collections.abc import Mapping, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

from fibercontact.bench.environment import ONE_THREAD, memory_share
from fibercontact.bench.protocol import BenchError
from fibercontact.errors import NO_CACHE

__all__ = ["Crashed", "Ended", "Hung", "Refused", "Setting", "Worker", "cause", "serve"]

START_SECONDS = 900.0
"""For imports and, the first time, compilation."""
LOAD_SECONDS = 600.0
"""For reading and condensing a problem."""
LAST_SECONDS = 5.0
"""What an orphan may live beyond the time limit of its request where it does not notice that it is one."""

PASSES = "fibercontact.bench.passes"


class Hung(Exception):
    """The request took longer than its limit; the process was killed."""


class Crashed(Exception):  # noqa: N818
    """The process died of the request."""


class Refused(Exception):
    """The request raised; the message says what."""


class Ended(Exception):
    """The run is over: no more requests are taken."""


class Setting(NamedTuple):
    """What a worker process is made with.

    `desk` names the module of the `Desk`; `core` pins the process; `memory` bounds it, in bytes. `fingerprints` are
    those of the solvers that the run began with.
    """

    plugins: Sequence[Path] = ()
    fingerprints: Mapping[str, str] = {}
    desk: str = PASSES
    core: int | None = None
    memory: int | None = None


class Worker:
    """A `Desk` in a process of its own, replaced by a new one when it hangs or crashes.

    The process has one thread of linear algebra, ends with its parent, and may use `setting.memory` bytes, three
    quarters of the machine's by default. `BenchError` is raised when a process comes up with other solvers than
    those of `setting.fingerprints`, or cannot load them at all.
    """

    def __init__(self, setting: Setting) -> None:
        self.setting = setting._replace(memory=setting.memory or memory_share())
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: Connection | None = None
        self._loaded: tuple[Path, str] | None = None
        self._ended = False

    def load(self, path: Path, start: str) -> dict[str, Any]:
        """Take a problem; returns its sizes. Raises `Hung`, `Crashed` or `Refused`."""
        self._loaded = None
        sizes: dict[str, Any] = self.ask("load", (path, start), LOAD_SECONDS)
        self._loaded = (path, start)
        return sizes

    def solve(self, path: Path, start: str, task: Any, limit: float) -> dict[str, Any]:
        """Do one pass on a problem, taken again when the process is a new one."""
        if self._loaded != (path, start):
            self.load(path, start)
        found: dict[str, Any] = self.ask("solve", (task,), limit)
        return found

    def renew(self) -> None:
        """Let the next request have a new process."""
        if self._process is not None:
            self._discard()

    def end(self) -> None:
        """Kill the process, now and for good; may be called from another thread."""
        self._ended = True
        if (process := self._process) is not None:
            process.kill()
            process.wait()

    def ask(self, name: str, arguments: tuple[Any, ...], limit: float) -> Any:
        """The desk's answer to one request. Raises `Hung`, `Crashed` or `Refused`."""
        connection = self._connection or self._start()
        return self._answer(connection, (name, arguments, limit), limit)

    def _answer(self, connection: Connection, request: Any, limit: float) -> Any:
        if self._ended:
            raise Ended
        try:
            connection.send(request)
            if not connection.poll(limit):
                self._discard()
                raise Hung(f"killed after {limit:g} s")
            kind, answer = connection.recv()
        except (EOFError, OSError):
            code = self._discard()
            if self._ended:
                raise Ended from None
            raise Crashed(cause(code)) from None
        if kind == "refused":
            raise Refused(answer)
        return answer

    def _discard(self) -> int:
        """Kill the process if it lives, and forget it; its exit code."""
        assert self._process is not None
        self._process.kill()
        code = self._process.wait()
        if self._connection is not None:
            self._connection.close()
        self._process = self._connection = self._loaded = None
        return code

    def _start(self) -> Connection:
        self._process, self._connection = _new_process()
        connection = self._connection
        try:
            found = self._answer(connection, self.setting, START_SECONDS)
        except (Hung, Crashed, Refused) as fault:
            raise BenchError(str(fault)) from None
        expected = self.setting.fingerprints
        if found != expected:
            changed = [label for label, value in expected.items() if found[label] != value]
            raise BenchError(f"the sources of {', '.join(changed)} changed during the run: start it again")
        return connection


def _new_process() -> tuple[subprocess.Popen[bytes], Connection]:
    """A process that serves, and our end of the line: a new program, for a fork would inherit locks and threads."""
    ours, theirs = socket.socketpair()
    with theirs:
        process = subprocess.Popen(
            [sys.executable, "-c", f"from {__name__} import serve; serve({theirs.fileno()})"],
            stdin=subprocess.DEVNULL,
            pass_fds=[theirs.fileno()],
            env=os.environ | ONE_THREAD | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        )
    return process, Connection(ours.detach())


def cause(code: int) -> str:
    """What an exit code says of the end of a process."""
    if code >= 0:
        return f"the process ended with code {code}"
    known = {int(member): member.name for member in signal.Signals}
    hint = ", as when the system runs out of memory" if code == -signal.SIGKILL else ""
    return f"the process died of {known.get(-code, f'signal {-code}')}{hint}"


def serve(file_descriptor: int) -> None:
    """Answer requests until the other end closes: what a worker's process does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides what an interruption means
    warnings.filterwarnings("ignore", NO_CACHE)  # which the parent has said
    threading.Thread(target=_die_with_parent, args=(file_descriptor,), daemon=True).start()
    connection = Connection(file_descriptor)
    try:
        desk = _desk(connection.recv())
        connection.send(("done", desk.fingerprints()))
    except Exception as fault:
        connection.send(("refused", _sentence(fault)))
        return
    while True:
        try:
            name, arguments, limit = connection.recv()
        except EOFError:
            return
        _alarm(limit + LAST_SECONDS)
        try:
            answer = ("done", getattr(desk, name)(*arguments))
        except Exception as fault:  # of a stranger's kernel or file: to be reported, not to die of
            answer = ("refused", _sentence(fault))
        _alarm(0.0)
        connection.send(answer)


def _desk(setting: Setting) -> Any:
    if setting.core is not None and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {setting.core})
    _bound_memory(setting.memory)
    return importlib.import_module(setting.desk).Desk(list(setting.plugins), list(setting.fingerprints))


def _bound_memory(memory: int | None) -> None:
    """Let allocations beyond `memory` bytes fail, here and in processes started from here (on Linux)."""
    if memory is not None and sys.platform == "linux":
        import resource

        _, most = resource.getrlimit(resource.RLIMIT_DATA)
        bound = memory if most == resource.RLIM_INFINITY else min(memory, most)
        resource.setrlimit(resource.RLIMIT_DATA, (bound, bound))


def _die_with_parent(file_descriptor: int) -> None:
    """Wait until the other end is closed, if only because its process is gone; then end, whatever is going on."""
    line = select.poll()
    line.register(file_descriptor, 0)  # nothing but the hang-up
    line.poll()
    os.kill(os.getpid(), signal.SIGKILL)


def _alarm(seconds: float) -> None:
    """The system ends the process then, even in a loop that lets no thread run; 0: never."""
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, seconds)


def _sentence(fault: Exception) -> str:
    known = isinstance(fault, ValueError)
    text = " ".join(str(fault).split())
    return text if known and text else f"{type(fault).__name__}: {text}"
