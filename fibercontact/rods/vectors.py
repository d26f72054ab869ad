"""Vectors in space as tuples, which the compiler keeps in registers."""

import numpy as np
from numpy.typing import NDArray

from fibercontact.jit import jit, jit_lean

__all__ = ["Vector", "along", "column", "cross", "norm", "row", "scaled"]

Vector = tuple[float, float, float]


@jit_lean
def row(vector: NDArray[np.float64]) -> Vector:
    """Vector (3,) as a tuple."""
    return vector[0], vector[1], vector[2]


@jit_lean
def column(matrix: NDArray[np.float64], i: int) -> Vector:
    """Column of a matrix (3, 3) as a tuple."""
    return matrix[0, i], matrix[1, i], matrix[2, i]


@jit
def cross(a: Vector, b: Vector) -> Vector:
    """Cross product of two vectors."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@jit
def along(a: Vector, x: float, b: Vector) -> Vector:
    """Point `a + x b` of a line."""
    return a[0] + x * b[0], a[1] + x * b[1], a[2] + x * b[2]


@jit
def norm(a: Vector) -> float:
    """Length of a vector."""
    return np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@jit
def scaled(x: float, a: Vector) -> Vector:
    """Vector `x a`."""
    return x * a[0], x * a[1], x * a[2]
