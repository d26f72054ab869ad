"""Worker processes that may hang or crash without taking the run with them."""

import importlib
import multiprocessing
import os
import signal
from collections.abc import Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from fibercontact.bench.protocol import BenchError

__all__ = ["Crashed", "Ended", "Hung", "Refused", "Worker"]

START_SECONDS = 900.0
"""For imports and, the first time, compilation."""
LOAD_SECONDS = 600.0
"""For reading and condensing a problem."""
LAST_SECONDS = 5.0
"""What an orphan may live beyond the time limit of its request."""


class Hung(Exception):
    """The request took longer than its limit; the process was killed."""


class Crashed(Exception):  # noqa: N818
    """The process died of the request."""


class Refused(Exception):
    """The request raised; the message says what."""


class Ended(Exception):
    """The run is over: no more requests are taken."""


class Worker:
    """A `Desk` in a process of its own, replaced by a new one when it hangs or crashes.

    `desk` names the module of the `Desk`; `core` pins the process. `fingerprints` are those of the solvers that
    the run began with: `BenchError` is raised when a process comes up with others, or cannot load the solvers at
    all.
    """

    def __init__(
        self,
        plugins: Sequence[Path],
        fingerprints: dict[str, str],
        core: int | None = None,
        desk: str = "fibercontact.bench.passes",
    ) -> None:
        self._plugins, self._fingerprints, self._core, self._desk = list(plugins), fingerprints, core, desk
        self._process: Any = None
        self._connection: Connection | None = None
        self._loaded: tuple[Path, str] | None = None
        self._ended = False

    def load(self, path: Path, start: str) -> dict[str, Any]:
        """Take a problem; returns its sizes. Raises `Hung`, `Crashed` or `Refused`."""
        self._loaded = None
        sizes = self.ask("load", (path, start), LOAD_SECONDS)
        self._loaded = (path, start)
        return sizes

    def solve(self, path: Path, start: str, task: Any, limit: float) -> dict[str, Any]:
        """Do one pass on a problem, taken again when the process is a new one."""
        if self._loaded != (path, start):
            self.load(path, start)
        return self.ask("solve", (task,), limit)

    def end(self) -> None:
        """Kill the process, now and for good; may be called from another thread."""
        self._ended = True
        if self._process is not None:
            self._process.kill()

    def ask(self, name: str, arguments: tuple[Any, ...], limit: float) -> Any:
        """The desk's answer to one request. Raises `Hung`, `Crashed` or `Refused`."""
        connection = self._connection or self._start()
        return self._answer(connection, (name, arguments, limit), limit)

    def _answer(self, connection: Connection, request: Any, limit: float) -> Any:
        if self._ended:
            raise Ended
        try:
            if request is not None:
                connection.send(request)
            if not connection.poll(limit):
                self._discard()
                raise Hung(f"killed after {limit:g} s")
            kind, answer = connection.recv()
        except (EOFError, OSError):
            code = self._discard()
            if self._ended:
                raise Ended from None
            raise Crashed(_cause(code)) from None
        if kind == "refused":
            raise Refused(answer)
        return answer

    def _discard(self) -> int | None:
        """Kill the process if it lives, and forget it; its exit code."""
        self._process.kill()
        self._process.join()
        code = self._process.exitcode
        if self._connection is not None:
            self._connection.close()
        self._process = self._connection = self._loaded = None
        return code

    def _start(self) -> Connection:
        context = multiprocessing.get_context("spawn")  # a forked process would inherit locks and threads
        self._connection, theirs = context.Pipe()
        arguments = (theirs, self._desk, self._plugins, list(self._fingerprints), self._core)
        self._process = context.Process(target=_serve, args=arguments, daemon=True)
        self._process.start()
        theirs.close()
        connection = self._connection
        try:
            found = self._answer(connection, None, START_SECONDS)
        except (Hung, Crashed, Refused) as fault:
            raise BenchError(str(fault)) from None
        if found != self._fingerprints:
            changed = [label for label, value in self._fingerprints.items() if found[label] != value]
            raise BenchError(f"the sources of {', '.join(changed)} changed during the run: start it again")
        return connection


def _cause(code: int | None) -> str:
    if code is not None and code < 0:
        return f"the process died of {signal.Signals(-code).name}"
    return f"the process ended with code {code}"


def _serve(
    connection: Connection, module: str, plugins: list[Path], solvers: list[str], core: int | None
) -> None:
    """Answer requests until the other end closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides what an interruption means
    if core is not None and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {core})
    try:
        desk = importlib.import_module(module).Desk(plugins, solvers)
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


def _alarm(seconds: float) -> None:
    """The system ends the process then, even in a compiled loop and with nobody left to kill it; 0: never."""
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, seconds)


def _sentence(fault: Exception) -> str:
    known = isinstance(fault, ValueError)
    text = " ".join(str(fault).split())
    return text if known and text else f"{type(fault).__name__}: {text}"
