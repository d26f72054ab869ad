"""The Lorentz cone of three dimensions, for all contacts at once: `{x : x_0 >= ‖x_T‖}`, vectors being (n, 3).

The Jordan product is `x∘y = (x·y, x_0 y_T + y_0 x_T)`; the scaling is that of Nesterov and Todd, SIAM J. Optim. 8,
1998.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Scaling", "arrow", "eigenvalues", "inside", "quotient", "scaling", "tangential", "times"]

Array = NDArray[np.float64]

REFLECTION = np.array([1.0, -1.0, -1.0])  # diagonal of J
TINY = 1e-300


class Scaling(NamedTuple):
    """Symmetric matrices `theta` and their `inverse`, (n, 3, 3), with `theta x = inverse y = point`, (n, 3)."""

    theta: Array
    inverse: Array
    point: Array


def tangential(x: Array) -> Array:
    """`‖x_T‖`, (n,)."""
    return np.hypot(x[:, 1], x[:, 2])


def inside(x: Array) -> bool:
    """Whether all of them are inside the cone, not on its boundary."""
    return bool(np.all(x[:, 0] > tangential(x)))


def times(blocks: Array, x: Array) -> Array:
    """Block by block product of (n, 3, 3) and (n, 3)."""
    return np.einsum("nij,nj->ni", blocks, x)


def arrow(x: Array) -> Array:
    """Return the matrices (n, 3, 3) of the Jordan product with x, `arrow(x) y = x∘y`."""
    found = x[:, 0, None, None] * np.eye(3)
    found[:, 0, 1:] = found[:, 1:, 0] = x[:, 1:]
    return found


def quotient(z: Array, x: Array) -> Array:
    """The `y` with `x∘y = z`."""
    y = np.empty_like(z)
    y[:, 0] = (x[:, 0] * z[:, 0] - np.sum(x[:, 1:] * z[:, 1:], axis=1)) / _determinant(x)
    y[:, 1:] = (z[:, 1:] - y[:, :1] * x[:, 1:]) / x[:, :1]
    return y


def _determinant(x: Array) -> Array:
    size = tangential(x)
    return (x[:, 0] - size) * (x[:, 0] + size)


def scaling(x: Array, y: Array) -> Scaling:
    """The scaling of Nesterov and Todd at points inside the cone, in closed form."""
    size_x, size_y = (np.sqrt(np.maximum(_determinant(z), TINY)) for z in (x, y))
    unit_x, unit_y = x / size_x[:, None], y / size_y[:, None]
    w = unit_y + REFLECTION * unit_x
    w /= np.sqrt(2.0 * (1.0 + np.sum(unit_x * unit_y, axis=1)))[:, None]
    root = np.sqrt(size_y / size_x)[:, None, None]
    boost = arrow(w)
    boost[:, 1:, 1:] = np.eye(2) + w[:, 1:, None] * w[:, None, 1:] / (1.0 + w[:, 0])[:, None, None]
    theta, inverse = root * boost, (REFLECTION[:, None] * REFLECTION) * boost / root
    return Scaling(theta, inverse, times(theta, x))


def eigenvalues(x: Array, y: Array) -> Array:
    """The eigenvalues (2, n) of `point∘point` of the scaling; all are lam exactly where `x∘y = lam e`."""
    trace, determinant = np.sum(x * y, axis=1), _determinant(x) * _determinant(y)
    larger = trace + np.sqrt(np.maximum(trace * trace - determinant, 0.0))
    return np.stack([determinant / larger, larger])
