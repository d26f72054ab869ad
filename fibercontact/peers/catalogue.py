"""The peers and their solvers: Siconos, and Pinocchio.

A solver has the peer's default options but for what is said here. A peer gets the tolerance that ours get; what it
means by it is its own affair, and its claim is stored beside our verdict.
"""

import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from fibercontact.global_methods.contract import GlobalMethod
from fibercontact.local.contract import Option
from fibercontact.peers.child import CHILDREN
from fibercontact.peers.method import peer_method
from fibercontact.peers.peer import Peer

__all__ = ["PEERS", "SOLVERS", "PeerSolver", "specifications"]

SICONOS = Peer(
    "siconos",
    CHILDREN / "siconos_child.py",
    "FIBERCONTACT_SICONOS_PYTHON",
    ("/usr/bin/python3", "python3", sys.executable),
    "apt install python3-siconos",
)
PINOCCHIO = Peer(
    "pinocchio",
    CHILDREN / "pinocchio_child.py",
    "FIBERCONTACT_PINOCCHIO_PYTHON",
    (sys.executable,),
    "pip install pin",
)
PEERS = {peer.name: peer for peer in (SICONOS, PINOCCHIO)}
"""The peers by name."""


@dataclass(frozen=True)
class PeerSolver:
    """A solver of a peer: what its desk finds it by, its options, and a line on what it is."""

    peer: Peer
    name: str
    documentation: str
    order: Mapping[str, str]
    options: Mapping[str, Option] = field(default_factory=dict)

    def method(self) -> GlobalMethod:
        """The solver as a global method."""
        return peer_method(self.peer, self.order, self.options)


FULL = {"full": Option(0.0, "1: its full error at every sweep; 0: its default, the change of a sweep")}


def _nsgs(name: str, local: str, what: str) -> PeerSolver:
    order = {"solver": "NSGS", "local": f"ONECONTACT_{local}"}
    return PeerSolver(SICONOS, name, f"Siconos' Gauss–Seidel (NSGS) with {what}.", order, FULL)


def _siconos(name: str, solver: str, what: str) -> PeerSolver:
    return PeerSolver(SICONOS, name, f"Siconos' {what} ({solver}).", {"solver": solver})


def _solvers() -> Iterator[PeerSolver]:
    yield _nsgs("siconos-nsgs", "NSN_GP_HYBRID", "its default local solver, damped Newton and projections")
    yield _nsgs("siconos-nsgs-newton", "NSN", "Alart–Curnier's Newton method, full steps")
    yield _nsgs("siconos-nsgs-damped", "NSN_GP", "Alart–Curnier's Newton method, Goldstein–Price line search")
    yield _nsgs("siconos-nsgs-quartic", "QUARTIC", "the enumeration by the slip quartic")
    yield _nsgs(
        "siconos-nsgs-projection", "ProjectionOnConeWithLocalIteration", "iterated projections on the cone"
    )
    yield _siconos("siconos-nsn-ac", "NSN_AC", "Newton method for all contacts on Alart–Curnier's function")
    yield _siconos(
        "siconos-nsn-fb", "NSN_FB", "Newton method for all contacts on Fischer–Burmeister's function"
    )
    yield _siconos("siconos-nsn-nm", "NSN_NM", "Newton method for all contacts on the natural map")
    yield _siconos("siconos-prox", "PROX", "proximal point iterations about the Newton method")
    yield _siconos("siconos-admm", "ADMM", "alternating direction method of multipliers")
    for name, what in (
        ("pgs", "projected Gauss–Seidel"),
        ("admm", "alternating direction method of multipliers"),
    ):
        line = f"Pinocchio's {what}, with De Saxcé's term."
        yield PeerSolver(PINOCCHIO, f"pinocchio-{name}", line, {"solver": name.upper()})


SOLVERS = {solver.name: solver for solver in _solvers()}
"""The peers' solvers by name."""


def specifications(peer: str) -> list[str]:
    """The solvers of a peer as the table has them: each way to evaluate the error is a row."""
    solvers = [solver for solver in SOLVERS.values() if solver.peer.name == peer]
    return [s.name + choice for s in solvers for choice in ("", ":full=1")[: 1 + ("full" in s.options)]]
