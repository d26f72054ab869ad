"""The end of a pipe where another Python runs a peer: messages, and the loop that answers them.

`python serve.py DESK.py` answers on its standard output what comes on its standard input, with the `Desk` of that
file. Only numpy and the peer are needed there: nothing of fibercontact is imported.

A message is `MAGIC`, the size of the rest, and an npz archive: arrays, and one more with the fields as JSON. The
requests, by their field `do`: `load` takes a problem, `warm` makes the peer's code ready on a small one, `solve`
answers with the impulses. What the desk raises is answered as a field `fault`.
"""

from __future__ import annotations

import ctypes
import io
import json
import os
import runpy
import signal
import struct
import sys
import zipfile
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Arrays = dict[str, NDArray[Any]]
    Fields = dict[str, Any]

__all__ = ["Garbled", "message", "receive"]

MAGIC = b"peer"
HEAD = struct.Struct("<4sQ")
FIELDS = "fields"
LAST_SECONDS = 5.0
"""What an orphan may live beyond the time limit of its request."""
PR_SET_PDEATHSIG = 1


class Garbled(Exception):
    """What came through the pipe is no message."""


def message(fields: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """The bytes of a message: fields that JSON knows, and arrays of numbers."""
    body = io.BytesIO()
    np.savez(body, **{FIELDS: np.frombuffer(json.dumps(fields).encode(), np.uint8)}, **arrays)  # type: ignore[arg-type]
    return HEAD.pack(MAGIC, body.tell()) + body.getvalue()


def receive(read: Callable[[int], bytes]) -> tuple[Fields, Arrays]:
    """The next message; `read(count)` gives fewer bytes only at the end. Raises `EOFError` there, `Garbled`."""
    head = read(HEAD.size)
    if head[: len(MAGIC)] != MAGIC[: len(head)]:
        raise Garbled(f"no message: {head!r}")
    if len(head) < HEAD.size:
        raise EOFError
    size = HEAD.unpack(head)[1]
    body = read(size)
    if len(body) < size:
        raise EOFError
    try:
        with np.load(io.BytesIO(body), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        return json.loads(arrays.pop(FIELDS).tobytes()), arrays
    except (ValueError, KeyError, OSError, zipfile.BadZipFile) as fault:
        raise Garbled(f"no message: {fault}") from fault


def serve(desk_file: str) -> None:
    """Answer requests until the other end closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides what an interruption means
    _die_with_parent()
    with os.fdopen(os.dup(0), "rb") as requests, os.fdopen(os.dup(1), "wb") as answers:
        nothing = os.open(os.devnull, os.O_RDWR)
        os.dup2(nothing, 0)
        os.dup2(nothing, 1)  # what the peer prints must not come between the answers
        desk, greeting = _open(desk_file)
        loaded: Any = None
        _send(answers, greeting, {})
        while desk is not None:
            try:
                fields, arrays = receive(requests.read)
            except EOFError:
                return
            _alarm(fields["seconds"] + LAST_SECONDS)
            answer: tuple[Fields, Arrays] = {}, {}
            try:
                if fields["do"] == "load":
                    loaded = desk.lay_out(**arrays)
                elif fields["do"] == "warm":
                    desk.solve(desk.lay_out(**_small_problem()), fields, np.zeros(6))
                else:
                    found, r = desk.solve(loaded, fields, arrays["start"])
                    answer = found, {"r": r}
            except Exception as fault:  # of a stranger's code: to be told, not to die of
                answer = _fault(fault), {}
            _alarm(0.0)
            _send(answers, *answer)


def _open(desk_file: str) -> tuple[Any, Fields]:
    """The desk, and its version to greet with; None and the fault when the peer is not here."""
    try:
        desk = runpy.run_path(desk_file)["Desk"]()
        return desk, {"version": desk.version}
    except Exception as fault:
        return None, _fault(fault)


def _fault(fault: Exception) -> Fields:
    """A `ValueError` says that the peer does not take the problem; its text is a sentence."""
    unsuited = isinstance(fault, ValueError)
    text = " ".join(str(fault).split())
    return {"fault": text if unsuited and text else f"{type(fault).__name__}: {text}", "unsuited": unsuited}


def _send(stream: Any, fields: Fields, arrays: Arrays) -> None:
    stream.write(message(fields, arrays))
    stream.flush()


def _small_problem() -> Arrays:
    """Two unit masses on a plane, pushed down and aside."""
    return {
        "starts": np.array([0, 1, 2]),
        "columns": np.array([0, 1]),
        "blocks": np.stack([np.eye(3), np.eye(3)]),
        "b": np.array([-1.0, 0.5, 0.0, -1.0, 0.1, 0.0]),
        "mu": np.array([0.3, 0.3]),
    }


def _alarm(seconds: float) -> None:
    """The system ends the process then, even in a compiled loop and with nobody left to kill it; 0: never."""
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, seconds)


def _die_with_parent() -> None:
    """Ask the system to kill this process when its parent dies, where it can (Linux)."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


if __name__ == "__main__":
    serve(sys.argv[1])
