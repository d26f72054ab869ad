"""A peer: what it is called, what runs it, and where a Python that has it is found."""

import os
import shutil
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from fibercontact.errors import UserError
from fibercontact.peers.child import Child, Died, Faulty, Late

__all__ = ["Found", "Missing", "Peer"]


class Missing(UserError):
    """A peer that no Python here has; the message says how to install it."""


@dataclass(frozen=True)
class Found:
    """A Python that has the peer, and the version that the peer says it is."""

    python: str
    version: str


@dataclass(frozen=True)
class Peer:
    """Somebody else's package of solvers, which the desk in a file of its own can drive.

    A Python that has it is looked for among `pythons` (names on the path, or files), or is the one that the
    environment variable `variable` names. `install` is what to do where there is none.
    """

    name: str
    desk: Path
    variable: str
    pythons: tuple[str, ...]
    install: str

    def find(self) -> Found:
        """The first Python that has it; raises `Missing`. Looked for once in a process."""
        return _find(self, os.environ.get(self.variable, ""))

    def start(self) -> Child:
        """A process of it; raises `Missing`, `Late`, `Died` or `Faulty`."""
        return Child(self.find().python, self.desk)


@cache
def _find(peer: Peer, named: str) -> Found:
    fault = ""
    for python in dict.fromkeys(shutil.which(name) for name in ((named,) if named else peer.pythons)):
        if python is None:
            continue
        try:
            child = Child(python, peer.desk)
        except (Late, Died, Faulty) as reason:
            fault = f" ({python}: {reason})" if named else ""
        else:
            child.end()
            return Found(python, child.version)
    place = f"in {named}{fault}" if named else "here"
    raise Missing(
        f"{peer.name} is not {place}: {peer.install}, or name a Python that has it in {peer.variable}"
    )
