"""Find solvers by name, the peers' among them; theirs carry the version that a peer says it is."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from fibercontact.global_methods import registry as ours
from fibercontact.global_methods.registry import AnyConfigured, AnyRegistered, ConfiguredMethod
from fibercontact.jit import content_key
from fibercontact.local.loading import Registered
from fibercontact.peers.catalogue import SOLVERS, PeerSolver

__all__ = ["configure", "registered"]


def registered(plugins: Sequence[Path] = ()) -> dict[str, AnyRegistered]:
    """Every solver by name, the peers' whether they are here or not; raises `SolverError` as for ours."""
    return {name: _entry(solver) for name, solver in SOLVERS.items()} | ours.registered(plugins)


def _entry(solver: PeerSolver) -> AnyRegistered:
    return Registered(
        solver.name, solver.method(), _origin(solver), solver.documentation, fingerprint="not looked for"
    )


def _origin(solver: PeerSolver) -> str:
    return f"peer: {solver.peer.name}"


def configure(specification: str, known: Mapping[str, AnyRegistered]) -> AnyConfigured:
    """Resolve `NAME[:option=value,...]`; raises `SolverError` as for ours, `Missing` when a peer is not here."""
    found = ours.configure(specification, known)
    solver = SOLVERS.get(found.registered.name)
    if (
        not isinstance(found, ConfiguredMethod)
        or solver is None
        or found.registered.origin != _origin(solver)
    ):
        return found
    return replace(found, registered=replace(found.registered, fingerprint=_fingerprint(solver)))


def _fingerprint(solver: PeerSolver) -> str:
    """Name and version of the peer, and the key of the code that drives it."""
    key = content_key(Path(__file__).parent.rglob("*.py"))
    return f"{solver.peer.name} {solver.peer.find().version} {key}"
