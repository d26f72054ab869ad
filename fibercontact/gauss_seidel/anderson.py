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

The maps themselves are remembered, a row each, and differences are formed where they are needed: the sweeps work on
a row of impulses and one of velocities, which are the newest image's when they are done, and the next iterate is
combined in the place of the oldest. All of this costs what the rows take to come from the caches; all but the few
numbers of the normal equations is done for a range of contacts at a time, by whoever has it.

References: Anderson, J. ACM 12, 1965; Walker and Ni, SIAM J. Numer. Anal. 49, 2011; THEORY §4.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fibercontact.jit import jit, jit_lean, jit_sum

__all__ = [
    "SUMS", "Acceleration", "Memory", "add_products", "add_steps", "ago", "another", "begin", "combine",
    "extrapolate", "go_on", "grow", "in_use", "leap", "newest", "store", "weights",
]  # fmt: skip

Array = NDArray[np.float64]
SUMS = 3
"""Rows of numbers that a range of contacts adds up: two of the normal equations, and what `opposes` asks for."""
LEAP = 2.0
"""Times that the last displacement is repeated where the least squares oppose the map."""
USED, RESIDUAL, NEWEST = range(3)


class Memory(NamedTuple):
    """The last maps in rows that are used in turn, and the iterate that the newest starts from."""

    F: Array  # (rows, size) g - x of each map, times scale
    G: Array  # (rows, size) images
    V: Array  # (rows, velocities) velocities of the images
    x: Array  # (size,)
    scale: Array  # (size,) in which maps are compared
    normal: Array  # (rows, rows): dF dFᵀ, with the difference of each map to the one before
    state: Array  # (3,): maps since the memory was dropped, residual after the last, row of the newest
    rounding: Array  # (rows,): of each row of V, in units of a product's

    def restart(self, r: Array) -> Array:
        """Drop what is remembered and go on from the iterate `r` (size,); returns the room for its velocity."""
        row = int(self.state[NEWEST])
        self.x[:] = self.G[row] = r
        self.state[USED] = 0.0
        return self.V[row]

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
    """Settings: sweeps a map, differences remembered, Tikhonov term relative to the largest normal-equation entry.

    Raises `ValueError` for a window of one, which has no room to step back from.
    """

    sweeps: int = 1
    window: int = 4
    tikhonov: float = 1e-12

    def __post_init__(self) -> None:
        if self.window == 1:
            raise ValueError("the window of an acceleration is two at least, or none: 0")

    def memory(self, start: Array, scale: Array | None = None, velocities: int = 0) -> Memory:
        """An empty memory for maps from `start` (size,), compared in `scale` (size,) or as they are.

        The first image goes to row 0, which holds the start.
        """
        size, rows = len(start), self.window + 1
        F, G, V = np.zeros((rows, size)), np.zeros((rows, size)), np.zeros((rows, velocities))
        G[0] = start
        scale = np.ones(size) if scale is None else scale
        return Memory(F, G, V, start.copy(), scale, np.zeros((rows, rows)), np.zeros(3), np.full(rows, 2.0))


@jit
def newest(m: Memory) -> int:
    """The row of the newest map, or of the one that is being done."""
    return int(m.state[NEWEST])


@jit
def ago(m: Memory, maps: int) -> int:
    """The row of the map that many maps before the newest; that of -1 is the next to be used."""
    return (newest(m) - maps) % len(m.F)


@jit
def in_use(m: Memory) -> int:
    """Differences to the newest map that are remembered."""
    return min(int(m.state[USED]), len(m.F) - 1)


@jit
def begin(m: Memory, residual: float) -> int:
    """Count the newest map, whose residual is given; returns how many differences are used for it."""
    if residual > 2.0 * m.state[RESIDUAL]:
        m.state[USED] = 0.0
    count = in_use(m)
    m.state[USED] += 1.0
    m.state[RESIDUAL] = residual
    return count


@jit
def go_on(m: Memory) -> None:
    """The next map begins, in the row of the oldest."""
    m.state[NEWEST] = ago(m, -1)


@jit_lean
def store(m: Memory, first: int, end: int) -> None:
    """Store what the newest map has changed."""
    f, g, x, scale = m.F[newest(m), first:end], m.G[newest(m), first:end], m.x[first:end], m.scale[first:end]
    for k in range(len(f)):
        f[k] = scale[k] * (g[k] - x[k])


@jit
def grow(m: Memory, alpha: Array) -> float:
    """Bound the rounding of the velocity that is combined with the weights alpha, in units of a product's.

    The map that starts from it adds one unit.
    """
    total = 0.0
    for row in range(len(alpha)):
        total += abs(alpha[row]) * m.rounding[row]
    m.rounding[ago(m, -1)] = total + 1.0
    return total


@jit_sum
def products(newer: Array, older: Array, new: Array, old: Array) -> tuple[float, float]:
    """`d·(new - old)` and `d·new` with `d = newer - older`."""
    with_newest, with_f = 0.0, 0.0
    for k in range(len(newer)):
        d = newer[k] - older[k]
        with_newest += d * (new[k] - old[k])
        with_f += d * new[k]
    return with_newest, with_f


@jit_lean
def add_products(m: Memory, count: int, first: int, end: int, sums: Array) -> None:
    """Write `ΔF_w·ΔF_0` and `ΔF_w·f` of this range into `sums`, the newest of `count` differences first."""
    new, old = m.F[newest(m), first:end], m.F[ago(m, 1), first:end]
    for w in range(count):
        sums[0, w], sums[1, w] = products(m.F[ago(m, w), first:end], m.F[ago(m, w + 1), first:end], new, old)


@jit_sum
def _steps(f: Array, scale: Array, after: Array, x: Array, g: Array, before: Array) -> tuple[float, float]:
    step, displacement = 0.0, 0.0
    for k in range(len(f)):
        scaled = scale[k] * f[k]
        step += scaled * (after[k] - x[k])
        displacement += scaled * (g[k] - before[k])
    return step, displacement


@jit_lean
def add_steps(m: Memory, first: int, end: int, sums: Array) -> None:
    """Write `f·(x_{m+1} - x_m)` and `f·(g_m - g_{m-1})` of this range, in scale, into `sums`."""
    row = newest(m)
    sums[2, 0], sums[2, 1] = _steps(
        m.F[row, first:end],
        m.scale[first:end],
        m.G[ago(m, -1), first:end],
        m.x[first:end],
        m.G[row, first:end],
        m.G[ago(m, 1), first:end],
    )


@jit
def weights(m: Memory, count: int, sums: Array, tikhonov: float) -> Array:
    """The weights (rows,) of the images in the next iterate; `sums` (SUMS, window) over all ranges."""
    row = newest(m)
    normal, gamma = np.zeros((count, count)), np.zeros(count)
    for w in range(count):
        m.normal[row, ago(m, w)] = m.normal[ago(m, w), row] = sums[0, w]
    for v in range(count):
        for w in range(count):
            normal[v, w] = m.normal[ago(m, v), ago(m, w)]
    largest = normal.max() if count > 0 else 0.0
    if not (largest > 0.0 and np.isfinite(largest)):
        return leap(m, 1.0 if count > 0 else 0.0)
    for w in range(count):
        normal[w, w] += tikhonov * largest
    gamma[:] = np.linalg.solve(normal, sums[1, :count].copy())
    if not np.isfinite(gamma.sum()):
        return leap(m, 1.0)
    alpha = leap(m, 0.0)
    for w in range(count):
        alpha[ago(m, w)] -= gamma[w]
        alpha[ago(m, w + 1)] += gamma[w]
    return alpha


@jit
def leap(m: Memory, times: float) -> Array:
    """The weights (rows,) that repeat the last displacement so many times `LEAP`."""
    alpha = np.zeros(len(m.F))
    alpha[newest(m)] = 1.0 + times * LEAP
    alpha[ago(m, 1)] -= times * LEAP
    return alpha


@jit
def another(m: Memory, sums: Array) -> Array:
    """The weights to be used instead of those of a step that opposes the map, (0,) if it does not."""
    if sums[2, 0] >= 0.0:
        return np.zeros(0)
    return leap(m, 1.0 if sums[2, 1] > 0.0 else 0.0)


@jit_lean
def combine(m: Memory, rows: Array, alpha: Array, first: int, end: int) -> None:
    """Write the rows with their weights, whose sum is 1, in place of the oldest; four at a time.

    What is added up are differences to the newest, which hardly round.
    """
    count = len(rows) - 1
    base, x = rows[newest(m), first:end], rows[ago(m, -1), first:end]
    for w in range(0, count, 4):
        at = (ago(m, count - w), ago(m, max(1, count - w - 1)), ago(m, max(1, count - w - 2)),
              ago(m, max(1, count - w - 3)))  # fmt: skip
        a, b = alpha[at[0]], alpha[at[1]] if w + 1 < count else 0.0
        c, d = alpha[at[2]] if w + 2 < count else 0.0, alpha[at[3]] if w + 3 < count else 0.0
        row0, row1 = rows[at[0], first:end], rows[at[1], first:end]
        row2, row3 = rows[at[2], first:end], rows[at[3], first:end]
        if w == 0:
            for k in range(len(x)):
                y = base[k]
                x[k] = y + ((a * (x[k] - y) + b * (row1[k] - y)) + (c * (row2[k] - y) + d * (row3[k] - y)))
        else:
            for k in range(len(x)):
                y = base[k]
                x[k] += (a * (row0[k] - y) + b * (row1[k] - y)) + (c * (row2[k] - y) + d * (row3[k] - y))


@jit
def extrapolate(m: Memory, image: Array, residual: float, tikhonov: float) -> None:
    """Store the map `m.x -> image`, whose residual is given, and write the next iterate into `m.x`."""
    size, sums = len(image), np.zeros((SUMS, max(2, len(m.F) - 1)))
    m.G[newest(m)] = image
    store(m, 0, size)
    count = begin(m, residual)
    add_products(m, count, 0, size, sums)
    combine(m, m.G, weights(m, count, sums, tikhonov), 0, size)
    add_steps(m, 0, size, sums)
    instead = another(m, sums)
    if len(instead) > 0:
        combine(m, m.G, instead, 0, size)
    go_on(m)
    m.x[:] = m.G[newest(m)]
