"""Anderson acceleration (type II) of the map "k sweeps", in the scaled variable `x_i = sqrt(sigma_i) r_i`.

With `g_m` the image of the iterate `x_m` and `f_m = g_m - x_m`, the next iterate is `g_m - ΔG gamma` with
gamma the Tikhonov-regularised least-squares solution of `min |f_m - ΔF gamma|`. The memory is dropped when
the residual more than doubles.

References: Anderson, J. ACM 12, 1965; Walker and Ni, SIAM J. Numer. Anal. 49, 2011; THEORY §4.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fibercontact.jit import jit

__all__ = ["Acceleration", "Memory", "extrapolate", "forget", "no_memory", "remember"]

Array = NDArray[np.float64]


class Memory(NamedTuple):
    """The differences of the last maps, one a row, and the last iterate and map."""

    dF: Array  # (window, 3n)
    dG: Array  # (window, 3n)
    x: Array  # (3n,) iterate that the next map starts from
    f: Array  # (3n,) of the last map
    g: Array  # (3n,) of the last map
    state: Array  # (2,): maps done since the memory was dropped, residual after the last map


@dataclass(frozen=True)
class Acceleration:
    """Settings: sweeps a map, maps remembered, Tikhonov term relative to the largest normal-equation entry."""

    sweeps: int = 3
    window: int = 8
    tikhonov: float = 1e-12

    def memory(self, size: int) -> Memory:
        """An empty memory for impulses of this size."""
        dF, dG = np.zeros((2, self.window, size))
        x, f, g = np.zeros((3, size))
        return Memory(dF, dG, x, f, g, np.zeros(2))


def no_memory() -> Memory:
    """The memory of a run that is not accelerated."""
    return Acceleration(window=0).memory(0)


def forget(m: Memory) -> None:
    """Drop the memory."""
    m.state[0] = 0.0


@jit
def remember(m: Memory, g: Array, residual: float) -> None:
    """Store the map `m.x -> g`: its differences to the map before, in place of the oldest."""
    if m.state[0] > 0.0 and residual > 2.0 * m.state[1]:
        m.state[0] = 0.0
    slot = int(m.state[0] - 1.0) % len(m.dF)
    for k in range(len(g)):
        f = g[k] - m.x[k]
        if m.state[0] > 0.0:
            m.dF[slot, k] = f - m.f[k]
            m.dG[slot, k] = g[k] - m.g[k]
        m.f[k], m.g[k] = f, g[k]
    m.state[0] += 1.0
    m.state[1] = residual


@jit
def extrapolate(m: Memory, tikhonov: float) -> None:
    """Write the next iterate, `g - ΔG gamma`, into `m.x`."""
    count = min(int(m.state[0]) - 1, len(m.dF))
    m.x[:] = m.g
    if count <= 0:
        return
    dF = m.dF[:count]
    normal = dF @ dF.T
    largest = normal.max()
    if not (largest > 0.0 and np.isfinite(largest)):
        return
    for k in range(count):
        normal[k, k] += tikhonov * largest
    gamma = np.linalg.solve(normal, dF @ m.f)
    if np.isfinite(gamma.sum()):
        for k in range(count):
            m.x[:] -= gamma[k] * m.dG[k]
