"""A peer's process: started, asked, killed when it is late, and told of when it dies."""

import os
import select
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from fibercontact.errors import UserError
from fibercontact.peers.children import serve

__all__ = ["CHILDREN", "Child", "Died", "Faulty", "Late", "Unsuitable"]

CHILDREN = Path(serve.__file__).parent
"""Where the desks of the peers are."""
START_SECONDS = 60.0
"""For the imports of the other Python."""
LAST_WORDS = 300
"""Characters of the standard error that are told when a process dies."""

Arrays = Mapping[str, NDArray[Any]]


class Late(Exception):
    """The process took longer than its limit, and was killed."""


class Died(UserError):
    """The process died, or wrote what is no message; it says of what."""


class Faulty(UserError):
    """The peer raised; the message says what."""


class Unsuitable(UserError):  # noqa: N818
    """The peer does not take the problem; the message says why."""


class Child:
    """A Python that runs the desk in the file `desk`. Raises `Late`, `Died` or `Faulty` when it does not come up."""

    def __init__(self, python: str, desk: Path) -> None:
        self._errors = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115
        try:
            self._process = subprocess.Popen(
                [python, serve.__file__, str(desk)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                bufsize=0,
                env=_environment(python),
            )
        except OSError as fault:
            self._errors.close()
            raise Died(f"it cannot be run: {fault.strerror}") from None
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._requests, self._answers = self._process.stdin, self._process.stdout
        os.set_blocking(self._requests.fileno(), False)
        self._begin("start", START_SECONDS)
        try:
            self.version = str(self._answer()[0]["version"])
        except BaseException:
            self.end()
            raise

    def ask(
        self, do: str, arrays: Arrays, limit: float, **fields: Any
    ) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        """The answer to one request within `limit` seconds.

        Raises `Late` and `Died`, after which there is no process any more, `Faulty` and `Unsuitable`.
        """
        self._begin(do, limit)
        self._errors.seek(0)  # the process writes where this file stands, too
        self._errors.truncate()
        self._write(serve.message({"do": do, "seconds": limit, **fields}, arrays))
        return self._answer()

    def end(self) -> None:
        """Kill the process, if it lives, and forget it."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._requests, self._answers, self._errors):
            pipe.close()

    def _begin(self, do: str, limit: float) -> None:
        self._deadline = time.monotonic() + limit
        self._late = f"{do}: no answer within {limit:g} s, killed"

    def _answer(self) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
        try:
            fields, arrays = serve.receive(self._read)
        except EOFError:
            raise self._death() from None
        except serve.Garbled as fault:
            self.end()
            raise Died(f"its answer is {fault}") from None
        if "fault" in fields:
            raise (Unsuitable if fields["unsuited"] else Faulty)(fields["fault"])
        return fields, arrays

    def _read(self, count: int) -> bytes:
        found = bytearray()
        while len(found) < count:
            self._wait(self._answers.fileno(), writing=False)
            piece = os.read(self._answers.fileno(), min(count - len(found), 1 << 20))
            if not piece:
                break
            found += piece
        return bytes(found)

    def _write(self, data: bytes) -> None:
        rest = memoryview(data)
        try:
            while rest:
                self._wait(self._requests.fileno(), writing=True)
                rest = rest[os.write(self._requests.fileno(), rest) :]
        except BrokenPipeError:
            raise self._death() from None

    def _wait(self, pipe: int, writing: bool) -> None:
        """Until the pipe is ready; raises `Late`, the process killed, when that is after the deadline."""
        left = max(0.0, self._deadline - time.monotonic())
        readable, writable = ([], [pipe]) if writing else ([pipe], [])
        if not any(select.select(readable, writable, [], left)):
            self.end()
            raise Late(self._late)

    def _death(self) -> Died | Late:
        """How the process ended, with the last that it wrote to its standard error; its own alarm says `Late`."""
        try:
            code = self._process.wait(1.0)  # the pipe may close a moment before the process is gone
        except subprocess.TimeoutExpired:
            code = 0
        self._errors.seek(0)
        words = " ".join(self._errors.read().decode(errors="replace").split())[-LAST_WORDS:]
        self.end()
        if code == -signal.SIGALRM:
            return Late(self._late)
        how = f"died of {signal.Signals(-code).name}" if code < 0 else f"ended with code {code}"
        return Died(f"its process {how}{': ' if words else ''}{words}")


def _environment(python: str) -> dict[str, str]:
    """Another Python must not find the packages of this one."""
    ours = os.environ.copy()
    if python != sys.executable:
        for name in ("PYTHONPATH", "PYTHONHOME"):
            ours.pop(name, None)
    return ours
