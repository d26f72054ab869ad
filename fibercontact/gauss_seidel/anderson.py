"""Anderson acceleration (type II) of the map "k sweeps", in the scaled variable `x_i = sqrt(sigma_i) r_i`.

With `g_m` the image of the iterate `x_m` and `f_m = g_m - x_m`, the next iterate is `g_m - ΔG gamma` with
gamma the Tikhonov-regularised least-squares solution of `min |f_m - ΔF gamma|`. The memory is dropped when
the residual more than doubles.

All but the few numbers of the normal equations is done for a range of contacts at a time, by whoever has it.

References: Anderson, J. ACM 12, 1965; Walker and Ni, SIAM J. Numer. Anal. 49, 2011; THEORY §4.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fibercontact.jit import jit, jit_sum

__all__ = [
    "Acceleration", "Memory", "add_products", "begin", "combine", "extrapolate", "forget", "no_memory",
    "store", "weights",
]  # fmt: skip

Array = NDArray[np.float64]


class Memory(NamedTuple):
    """The differences of the last maps, one a row, and the last iterate and map."""

    dF: Array  # (window, 3n)
    dG: Array  # (window, 3n)
    x: Array  # (3n,) iterate that the next map starts from
    f: Array  # (3n,) of the last map
    g: Array  # (3n,) of the last map
    image: Array  # (3n,) of the map at hand, before it is stored
    normal: Array  # (window, window): dF dFᵀ
    state: Array  # (2,): maps done since the memory was dropped, residual after the last map

    def own(self) -> "Memory":
        """The same memory for another thread, which keeps its own few numbers."""
        return self._replace(normal=self.normal.copy(), state=self.state.copy())


@dataclass(frozen=True)
class Acceleration:
    """Settings: sweeps a map, maps remembered, Tikhonov term relative to the largest normal-equation entry."""

    sweeps: int = 3
    window: int = 8
    tikhonov: float = 1e-12

    def memory(self, size: int) -> Memory:
        """An empty memory for impulses of this size."""
        dF, dG = np.zeros((2, self.window, size))
        x, f, g, image = np.zeros((4, size))
        return Memory(dF, dG, x, f, g, image, np.zeros((self.window, self.window)), np.zeros(2))


def no_memory() -> Memory:
    """The memory of a run that is not accelerated."""
    return Acceleration(window=0).memory(0)


def forget(m: Memory) -> None:
    """Drop the memory."""
    m.state[0] = 0.0


@jit
def begin(m: Memory, residual: float) -> tuple[int, int]:
    """Make room for a map: the row that its differences go to (-1: there are none), and the rows in use with it."""
    if m.state[0] > 0.0 and residual > 2.0 * m.state[1]:
        m.state[0] = 0.0
    before = int(m.state[0])
    m.state[0] += 1.0
    m.state[1] = residual
    window = len(m.dF)
    return ((before - 1) % window, min(before, window)) if before > 0 and window > 0 else (-1, 0)


@jit
def store(m: Memory, row: int, first: int, end: int) -> None:
    """Store the map `m.x -> m.image`: its differences to the map before, in place of the oldest."""
    image, x, f, g = m.image, m.x, m.f, m.g
    if row >= 0:
        dF, dG = m.dF[row], m.dG[row]
        for k in range(first, end):
            dF[k] = image[k] - x[k] - f[k]
            dG[k] = image[k] - g[k]
    for k in range(first, end):
        f[k] = image[k] - x[k]
        g[k] = image[k]


@jit_sum
def products(x: Array, y: Array, z: Array) -> tuple[float, float]:
    """`x·y` and `x·z`."""
    with_y, with_z = 0.0, 0.0
    for k in range(len(x)):
        with_y += x[k] * y[k]
        with_z += x[k] * z[k]
    return with_y, with_z


@jit
def add_products(m: Memory, row: int, count: int, first: int, end: int, sums: Array) -> None:
    """Write `dF_w·dF_row` and `dF_w·f` of this range into `sums` (2, window)."""
    newest, f = m.dF[row, first:end], m.f[first:end]
    for w in range(count):
        sums[0, w], sums[1, w] = products(m.dF[w, first:end], newest, f)


@jit
def weights(m: Memory, row: int, count: int, sums: Array, tikhonov: float) -> Array:
    """The gamma (count,) of the newest map, zero where it cannot be found; `sums` over all ranges."""
    m.normal[row, :count] = sums[0, :count]
    m.normal[:count, row] = sums[0, :count]
    gamma = np.zeros(count)
    normal = m.normal[:count, :count].copy()
    largest = normal.max()
    if not (largest > 0.0 and np.isfinite(largest)):
        return gamma
    for k in range(count):
        normal[k, k] += tikhonov * largest
    found = np.linalg.solve(normal, sums[1, :count].copy())
    if np.isfinite(found.sum()):
        gamma[:] = found
    return gamma


@jit
def combine(m: Memory, gamma: Array, first: int, end: int) -> None:
    """Write the next iterate, `g - ΔG gamma`, into `m.x`; four rows at a time, which is read once for them."""
    x, dG, count = m.x, m.dG, len(gamma)
    x[first:end] = m.g[first:end]
    for w in range(0, count, 4):
        rows = (w, min(w + 1, count - 1), min(w + 2, count - 1), min(w + 3, count - 1))
        a, b = gamma[w], gamma[rows[1]] if w + 1 < count else 0.0
        c, d = gamma[rows[2]] if w + 2 < count else 0.0, gamma[rows[3]] if w + 3 < count else 0.0
        row0, row1, row2, row3 = dG[rows[0]], dG[rows[1]], dG[rows[2]], dG[rows[3]]
        for k in range(first, end):
            x[k] -= (a * row0[k] + b * row1[k]) + (c * row2[k] + d * row3[k])


@jit
def extrapolate(m: Memory, image: Array, residual: float, tikhonov: float) -> None:
    """Store the map `m.x -> image`, whose residual is given, and write the next iterate into `m.x`."""
    m.image[:] = image
    row, count = begin(m, residual)
    store(m, row, 0, len(image))
    gamma = np.zeros(count)
    if count > 0:
        sums = np.zeros((2, count))
        add_products(m, row, count, 0, len(image), sums)
        gamma = weights(m, row, count, sums, tikhonov)
    combine(m, gamma, 0, len(image))
