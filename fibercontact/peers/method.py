"""A peer's solver as a global method: the problem handed over, the impulses taken back."""

import math
from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fibercontact.errors import UserError
from fibercontact.gauss_seidel.blocks import BlockSystem
from fibercontact.global_methods.contract import Answer, GlobalMethod, Task, Unsuited
from fibercontact.local.contract import Option
from fibercontact.peers.child import Child, Faulty, Late, Unsuitable
from fibercontact.peers.peer import Peer

__all__ = ["Units", "blocks_of", "peer_method", "units_of"]

Array = NDArray[np.float64]

LOAD_SECONDS = 120.0
"""For handing a problem over."""
WARM_SECONDS = 10.0
"""For a solve of two contacts."""
ANSWER_SECONDS = 1.0
"""For the answer to come back, beyond the time of the solve."""

COMMON = {
    "scaled": Option(1.0, "1: in units in which W and b are of size 1; 0: in those of the problem, as it is"),
    "margin": Option(1.0, "what the tolerance is divided by before the peer gets it: its measure is another"),
}
"""Options of every solver of a peer."""


class Units(NamedTuple):
    """The sizes of a problem that it is handed over in, powers of two: nothing is rounded."""

    W: float  # 1/kg
    b: float  # m/s

    @property
    def r(self) -> float:
        """Unit of the impulses, N·s."""
        return self.b / self.W


def units_of(system: BlockSystem, b_ref: float) -> Units:
    """The powers of two next to the mean of `sigma` and to `b_ref`."""
    return Units(_power_of_two(float(system.sigma.mean())), _power_of_two(b_ref or 1.0))


def _power_of_two(x: float) -> float:
    return 2.0 ** round(math.log2(x))


def blocks_of(system: BlockSystem) -> Array:
    """The blocks of W, (blocks, 3, 3), in the order of `system.columns`."""
    return np.reshape(system.blocks[: 9 * len(system.columns)], (-1, 3, 3))


class _Session(NamedTuple):
    """A process of a peer with the problem that it has taken."""

    child: Child
    system: BlockSystem
    units: Units


_sessions: dict[tuple[Peer, bool], _Session] = {}
"""One a peer and kind of units: a new problem gets a new process, for peers keep memory that they have done with."""


def peer_method(peer: Peer, order: Mapping[str, str], options: Mapping[str, Option]) -> GlobalMethod:
    """The solver that the peer's desk finds by `order`; `options` are handed to it, beside those of `COMMON`."""
    declared = {**options, **COMMON}
    solve = partial(_solve, peer, dict(order), tuple(declared))
    return GlobalMethod(solve, declared, prepare=peer.find)


def _solve(
    peer: Peer, order: dict[str, str], names: tuple[str, ...], system: BlockSystem, task: Task, options: Array
) -> Answer:
    """Ask the peer; impulses of zero when it is late. Raises `Unsuited`, `Died`, `Faulty` or `Missing`."""
    if len(system.mu) == 0:
        return Answer(np.zeros(0), True, 0, 0.0, 0.0, "no contacts")
    given = dict(zip(names, options.tolist(), strict=True))
    scaled, margin = bool(given.pop("scaled")), given.pop("margin")
    if not margin > 0.0:
        raise UserError(f"margin must be positive: it is {margin:g}")
    units = units_of(system, task.b_ref) if scaled else Units(1.0, 1.0)
    asked = order | given | {
        "tolerance": task.tolerance / margin, "b_ref": task.b_ref / units.b, "max_iterations": task.max_iterations
    }  # fmt: skip
    try:
        return _answer(*_exchange((peer, scaled), system, units, task, asked), units, system)
    except Late as late:
        return Answer(np.zeros_like(system.b), False, 0, seconds=task.max_seconds, note=str(late))
    except Unsuitable as reason:
        raise Unsuited(str(reason)) from None


def _exchange(
    key: tuple[Peer, bool], system: BlockSystem, units: Units, task: Task, asked: dict[str, Any]
) -> tuple[dict[str, Any], dict[str, Array]]:
    """Hand the problem over, if that has not been done, and have it solved.

    A process that has gone is forgotten, and one that was not waited for is ended: its answer may still come.
    """
    start = np.zeros_like(system.b) if task.start is None else task.start / units.r
    try:
        child = _loaded(key, system, units)
        child.ask("warm", {}, WARM_SECONDS, **asked)
        return child.ask("solve", {"start": start}, task.max_seconds + ANSWER_SECONDS, **asked)
    except (Faulty, Unsuitable):
        raise
    except BaseException:
        if session := _sessions.pop(key, None):
            session.child.end()
        raise


def _answer(found: dict[str, Any], arrays: dict[str, Array], units: Units, system: BlockSystem) -> Answer:
    r = arrays["r"]
    if r.shape != system.b.shape:
        raise Faulty(f"its impulses have shape {r.shape}")
    return Answer(
        r * units.r, found["claimed"], found["iterations"], found["error"], found["seconds"], found["note"]
    )


def _loaded(key: tuple[Peer, bool], system: BlockSystem, units: Units) -> Child:
    """The peer's process that has this problem in these units, a new one if need be."""
    session = _sessions.get(key)
    if session is not None and session.units == units and _same(session.system, system):
        return session.child
    if session is not None:
        _sessions.pop(key).child.end()
    child = key[0].start()
    try:
        child.ask("load", _handed_over(system, units), LOAD_SECONDS)
    except BaseException:
        child.end()
        raise
    _sessions[key] = _Session(child, system, units)
    return child


def _same(one: BlockSystem, other: BlockSystem) -> bool:
    names = ("starts", "columns", "blocks", "b", "mu")
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in names)


def _handed_over(system: BlockSystem, units: Units) -> dict[str, NDArray[Any]]:
    return {
        "starts": system.starts,
        "columns": system.columns,
        "blocks": blocks_of(system) / units.W,
        "b": system.b / units.b,
        "mu": system.mu,
    }
