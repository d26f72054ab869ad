"""Anderson acceleration (type II) of the map "k sweeps", in the norm of `sqrt(sigma_i) r_i`.

With `g_m` the image of the iterate `x_m` and `f_m = g_m - x_m`, the next iterate is `g_m - ΔG gamma` with
gamma the Tikhonov-regularised least-squares solution of `min |f_m - ΔF gamma|`. The memory is dropped when
the residual more than doubles.

Where impulses drift, map after map by the same `f` for thousands of maps, the least squares fit its small changes
only and lead to and fro at random. So a step that opposes the map, `f·(x_{m+1} - x_m) < 0`, is not taken: the last
displacement `g_m - g_{m-1}` is repeated `LEAP` times instead, if it goes with the map, so that steps grow
geometrically until something changes (docs/outer_loops.md).

The velocity is affine in the impulse, so that of the next iterate is combined from the images' like the iterate,
which is cheaper than a product with W but adds up rounding; `grow` bounds it.

All but the few numbers of the normal equations is done for a range of contacts at a time, by whoever has it.

References: Anderson, J. ACM 12, 1965; Walker and Ni, SIAM J. Numer. Anal. 49, 2011; THEORY §4.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fibercontact.jit import jit, jit_sum

__all__ = [
    "SUMS", "Acceleration", "Memory", "add_products", "begin", "combine", "extrapolate", "forget", "grow",
    "no_memory", "store", "store_velocity", "weights",
]  # fmt: skip

Array = NDArray[np.float64]
SUMS = 4
"""Rows of numbers that a range of contacts adds to the normal equations."""
LEAP = 2.0
"""Times that the last displacement is repeated where the least squares oppose the map."""


class Memory(NamedTuple):
    """The differences of the last maps, one a row, and the last iterate and map."""

    dF: Array  # (window, size), times scale
    dG: Array  # (window, size)
    dV: Array  # (window, velocities), of the images' velocities
    x: Array  # (size,) iterate that the next map starts from
    f: Array  # (size,) of the last map, times scale
    g: Array  # (size,) of the last map
    v: Array  # (velocities,) of g
    scale: Array  # (size,) in which maps are compared
    normal: Array  # (window, window): dF dFᵀ
    state: Array  # (2,): maps done since the memory was dropped, residual after the last map
    rounding: Array  # (window + 1,): of each row of dV and of the velocity at hand, in units of a product's

    def own(self) -> "Memory":
        """The same memory for another thread, which keeps its own few numbers."""
        return self._replace(
            normal=self.normal.copy(), state=self.state.copy(), rounding=self.rounding.copy()
        )

    def copy_numbers(self, other: "Memory") -> None:
        """Take the few numbers from another thread's."""
        self.normal[:], self.state[:], self.rounding[:] = other.normal, other.state, other.rounding


@dataclass(frozen=True)
class Acceleration:
    """Settings: sweeps a map, maps remembered, Tikhonov term relative to the largest normal-equation entry."""

    sweeps: int = 1
    window: int = 4
    tikhonov: float = 1e-12

    def memory(self, start: Array, scale: Array | None = None, velocities: int = 0) -> Memory:
        """An empty memory for maps from `start` (size,), compared in `scale` (size,) or as they are."""
        size, window = len(start), self.window
        dF, dG = np.zeros((2, window, size))
        f, g = np.zeros((2, size))
        scale = np.ones(size) if scale is None else scale
        dV, v, normal = np.zeros((window, velocities)), np.zeros(velocities), np.zeros((window, window))
        return Memory(dF, dG, dV, start.copy(), f, g, v, scale, normal, np.zeros(2), np.ones(window + 1))


def no_memory() -> Memory:
    """The memory of a run that is not accelerated."""
    return Acceleration(window=0).memory(np.zeros(0))


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
def store(m: Memory, row: int, image: Array, first: int, end: int) -> None:
    """Store the map `m.x -> image`: its differences to the map before, in place of the oldest."""
    image, x, f, scale = image[first:end], m.x[first:end], m.f[first:end], m.scale[first:end]
    if row < 0:
        for k in range(len(f)):
            f[k] = scale[k] * (image[k] - x[k])
    else:  # loops over few arrays, which the compiler makes vector loops of
        dF, dG, g = m.dF[row, first:end], m.dG[row, first:end], m.g[first:end]
        for k in range(len(f)):
            dF[k] = scale[k] * (image[k] - x[k]) - f[k]
        for k in range(len(f)):
            f[k] += dF[k]
        for k in range(len(f)):
            dG[k] = image[k] - g[k]
    m.g[first:end] = image


@jit
def store_velocity(m: Memory, row: int, u: Array, first: int, end: int) -> None:
    """Store the velocity of the map's image."""
    u, v = u[first:end], m.v[first:end]
    if row >= 0:
        dV = m.dV[row, first:end]
        for k in range(len(v)):
            dV[k] = u[k] - v[k]
    v[:] = u


@jit
def grow(m: Memory, row: int, gamma: Array) -> float:
    """Bound the rounding of the velocity that is combined with gamma, in units of a product's.

    Each map adds one unit; the rounding of a difference is at most that of both its terms.
    """
    last = len(m.dV)
    before, now = m.rounding[last], m.rounding[last] + 1.0
    if row >= 0:
        m.rounding[row] = now + before
    for w in range(len(gamma)):
        now += abs(gamma[w]) * m.rounding[w]
    m.rounding[last] = now
    return now


@jit_sum
def dot(x: Array, y: Array) -> float:
    """`x·y`."""
    total = 0.0
    for k in range(len(x)):
        total += x[k] * y[k]
    return total


@jit_sum
def products(dF: Array, newest: Array, f: Array, dG: Array, scaled: Array) -> tuple[float, float, float]:
    """`dF·newest`, `dF·f` and `dG·scaled`."""
    with_newest, with_f, along = 0.0, 0.0, 0.0
    for k in range(len(dF)):
        with_newest += dF[k] * newest[k]
        with_f += dF[k] * f[k]
        along += dG[k] * scaled[k]
    return with_newest, with_f, along


@jit
def add_products(m: Memory, row: int, count: int, first: int, end: int, sums: Array) -> None:
    """Write `dF_w·dF_row`, `dF_w·f`, `dG_w·f` (both times scale) and, once, `f·f` of this range into `sums`."""
    newest, f = m.dF[row, first:end], m.f[first:end]
    scaled = m.scale[first:end] * f
    for w in range(count):
        sums[0, w], sums[1, w], sums[2, w] = products(
            m.dF[w, first:end], newest, f, m.dG[w, first:end], scaled
        )
    sums[3, 0] = dot(f, f)


@jit
def weights(m: Memory, row: int, count: int, sums: Array, tikhonov: float) -> Array:
    """The gamma (count,) of the newest map; `sums` (SUMS, window) over all ranges."""
    m.normal[row, :count] = sums[0, :count]
    m.normal[:count, row] = sums[0, :count]
    gamma = np.zeros(count)
    normal = m.normal[:count, :count].copy()
    largest = normal.max()
    solvable = largest > 0.0 and np.isfinite(largest)
    if solvable:
        for k in range(count):
            normal[k, k] += tikhonov * largest
        gamma[:] = np.linalg.solve(normal, sums[1, :count].copy())
        solvable = np.isfinite(gamma.sum())
    along = sums[3, 0]  # f·(x_{m+1} - x_m)
    for k in range(count):
        along -= gamma[k] * sums[2, k]
    if not (solvable and along >= 0.0):
        gamma[:] = 0.0
        if sums[2, row] > 0.0:
            gamma[row] = -LEAP
    return gamma


@jit
def combine(start: Array, rows: Array, gamma: Array, first: int, end: int, x: Array) -> None:
    """Write `start - gamma rows` into `x`; four rows at a time, which is read once for them."""
    count = len(gamma)
    x = x[first:end]
    x[:] = start[first:end]
    for w in range(0, count, 4):
        at = (w, min(w + 1, count - 1), min(w + 2, count - 1), min(w + 3, count - 1))
        a, b = gamma[w], gamma[at[1]] if w + 1 < count else 0.0
        c, d = gamma[at[2]] if w + 2 < count else 0.0, gamma[at[3]] if w + 3 < count else 0.0
        row0, row1 = rows[at[0], first:end], rows[at[1], first:end]
        row2, row3 = rows[at[2], first:end], rows[at[3], first:end]
        for k in range(len(x)):
            x[k] -= (a * row0[k] + b * row1[k]) + (c * row2[k] + d * row3[k])


@jit
def extrapolate(m: Memory, image: Array, residual: float, tikhonov: float) -> None:
    """Store the map `m.x -> image`, whose residual is given, and write the next iterate into `m.x`."""
    row, count = begin(m, residual)
    store(m, row, image, 0, len(image))
    gamma = np.zeros(count)
    if count > 0:
        sums = np.zeros((SUMS, count))
        add_products(m, row, count, 0, len(image), sums)
        gamma = weights(m, row, count, sums, tikhonov)
    combine(m.g, m.dG, gamma, 0, len(image), m.x)
