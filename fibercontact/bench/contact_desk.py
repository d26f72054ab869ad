"""One solver on one set of contacts: what a worker process does at level 1, one request at a time."""

from collections.abc import Sequence
from pathlib import Path

from fibercontact.local.one_contact import OneContacts, Replay, compile_replay, read, replay
from fibercontact.local.registry import configure, registered

__all__ = ["Desk"]


class Desk:
    """The solvers of a table, compiled, and the contacts at hand."""

    def __init__(self, plugins: Sequence[Path], solvers: Sequence[str]) -> None:
        known = registered(plugins)
        self._solvers = {label: configure(label, known) for label in solvers}
        self._contacts: dict[Path, OneContacts] = {}
        for local in self._solvers.values():
            local.kernel()  # compiled but not run: a stranger's kernel may hang
        compile_replay()

    def fingerprints(self) -> dict[str, str]:
        """What the solvers were compiled from."""
        return {label: local.registered.fingerprint for label, local in self._solvers.items()}

    def replay(self, path: Path, solver: str) -> Replay:
        """Solve every contact of a file once."""
        if path not in self._contacts:
            self._contacts[path] = read(path)
        return replay(self._solvers[solver], self._contacts[path])
