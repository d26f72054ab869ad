"""The two bases of curvature `kappa(s) = Σ_j phi_j(s) q_j`, told apart by a number at run time (THEORY §6).

Whatever depends on the basis is here: how many shape functions `phi` an element has, their values, and the
transport of frame and centreline. Coefficient `e + a` belongs to shape `a` of element `e`, so `N` coefficients
make `N + 1 − shapes` elements of equal length.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fibercontact.jit import jit, jit_lean
from fibercontact.rods import superclothoid, superhelix

__all__ = ["CLOTHOID", "HELIX", "Path", "carry", "element_count", "new_path", "shape", "shapes"]

Array = NDArray[np.float64]

HELIX = 0  # curvature constant in an element
CLOTHOID = 1  # curvature linear in an element, continuous


@jit
def shapes(basis: int) -> int:
    """Count the functions phi that are not zero in an element."""
    return superclothoid.SHAPES if basis == CLOTHOID else superhelix.SHAPES


@jit_lean
def element_count(basis: int, q: Array) -> int:
    """Count the elements of rods with coefficients `q` (R, N, 3)."""
    return q.shape[1] + 1 - shapes(basis)


@jit
def shape(basis: int, a: int, xi: float) -> float:
    """Value of an element's shape function `a` at `xi` in [0, 1]."""
    return superclothoid.shape(a, xi) if basis == CLOTHOID else superhelix.shape(a, xi)


class Path(NamedTuple):
    """Work space for ascending places of an element, and the frames and positions there."""

    place: Array  # (m,) in [0, 1]
    frame: Array  # (m, 3, 3)
    position: Array  # (m, 3)


@jit
def new_path(places: int) -> Path:
    """Make a path of as many places."""
    return Path(np.empty(places), np.empty((places, 3, 3)), np.empty((places, 3)))


@jit_lean
def carry(basis: int, coefficients: Array, length: float, frame: Array, position: Array, path: Path) -> None:
    """Fill the frames and positions of `path` from those at the start of its element.

    The curvatures are `Σ_a phi_a coefficients[a]`, rad/m; `length` is that of the element, m. The start may be
    kept at the end of the path.
    """
    places, frames, positions = path
    if basis == CLOTHOID:
        superclothoid.transport(coefficients, length, places, frame, position, frames, positions)
    else:
        superhelix.transport(coefficients, length, places, frame, position, frames, positions)
