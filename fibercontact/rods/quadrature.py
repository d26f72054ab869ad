"""Gauss–Legendre rules on [0, 1], with the integration matrix of the collocation method on the same nodes."""

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray

__all__ = ["Rule", "gauss"]


class Rule(NamedTuple):
    """`∫_0^1 f ≈ weights·f(nodes)` and `∫_0^{nodes[k]} f ≈ matrix[k]·f(nodes)`.

    The second is exact for polynomials of degree below the number n of nodes. Integrals nested in one another
    by it are nevertheless of order 2n at the end of the interval: it is the Butcher matrix of the Gauss
    method [Hairer, Lubich & Wanner, Geometric Numerical Integration, II.1.3].
    """

    nodes: NDArray[np.float64]
    weights: NDArray[np.float64]
    matrix: NDArray[np.float64]


@cache
def gauss(count: int) -> Rule:
    """Give the Gauss–Legendre rule with `count` nodes."""
    x, w = leggauss(count)
    nodes = (x + 1) / 2
    return Rule(nodes, w / 2, np.column_stack([_lagrange(nodes, k).integ()(nodes) for k in range(count)]))


def _lagrange(nodes: NDArray[np.float64], k: int) -> Polynomial:
    others = np.delete(nodes, k)
    return Polynomial.fromroots(others) / np.prod(nodes[k] - others)
