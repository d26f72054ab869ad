"""Contact Jacobian H and free velocity w of u = H v + w, from contacts and the rods' point Jacobians."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from fibercontact.contact.detect import Contacts
from fibercontact.contact.frame import contact_frames
from fibercontact.contact.obstacles import Obstacle
from fibercontact.jit import jit, jit_lean

__all__ = ["ContactSystem", "assemble", "obstacle_drift"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class ContactSystem(NamedTuple):
    """Relative velocities u = H v + w of n contacts, in the local frames (N, T1, T2)."""

    H: csr_array  # (3 n, R D)
    w: Floats  # (3 n,) m/s
    frames: Floats  # (n, 3, 3) rows N, T1, T2: a local impulse r is the vector frames[i].T @ r


def assemble(
    contacts: Contacts,
    jacobian_a: Floats,
    jacobian_b: Floats,
    drift_a: Floats,
    drift_b: Floats,
    *,
    dt: float,
    rods: int,
    beta: float = 0.2,
    v_max: float = 0.1,
) -> ContactSystem:
    """Assemble u = H v + w for n contacts of `rods` rods with D degrees of freedom each.

    The material points in contact move with jacobian_a v_a + drift_a and jacobian_b v_b + drift_b, Jacobians
    (n, 3, D) and drifts (n, 3) in m/s: the drift of a rod is what its clamped root imposes, that of an
    obstacle its velocity (`obstacle_drift`); jacobian_b is not read where B is an obstacle. In v the degrees
    of freedom of rod a start at a D.

    The gap g, in m, enters the normal component, so that u_N ≥ 0 is g + dt (relative velocity) ≥ 0: w_N has
    g / dt for open contacts, and max(beta g / dt, -v_max) for penetrating ones, which are pushed out at v_max
    m/s at most. dt is in s.

    Raises ValueError for arrays that do not fit the contacts, and dt, beta or v_max out of range.
    """
    n, D = len(contacts.gap), jacobian_a.shape[-1]
    for name, array, shape in (
        ("jacobian_a", jacobian_a, (n, 3, D)),
        ("jacobian_b", jacobian_b, (n, 3, D)),
        ("drift_a", drift_a, (n, 3)),
        ("drift_b", drift_b, (n, 3)),
    ):
        if array.shape != shape:
            raise ValueError(f"{name} must be {shape} for {n} contacts, got {array.shape}")
    if not (dt > 0.0 and beta >= 0.0 and v_max >= 0.0):
        raise ValueError(f"need dt > 0, beta ≥ 0, v_max ≥ 0, got {dt!r}, {beta!r}, {v_max!r}")
    frames = contact_frames(contacts.normal)
    w = np.einsum("nij,nj->ni", frames, drift_a - drift_b)
    w[:, 0] += _gap_velocity(contacts.gap, dt, beta, v_max)
    jacobians = np.ascontiguousarray(jacobian_a), np.ascontiguousarray(jacobian_b)
    blocks = _csr_blocks(frames, contacts.fibre_a, contacts.fibre_b, *jacobians)
    return ContactSystem(csr_array(blocks, shape=(3 * n, rods * D)), w.ravel(), frames)


def obstacle_drift(contacts: Contacts, obstacles: Sequence[Obstacle]) -> Floats:
    """Velocities (m, 3), in m/s, of the obstacles at the contact points; zero for contacts between fibres."""
    drift = np.zeros_like(contacts.point)
    for index, obstacle in enumerate(obstacles):
        here = contacts.obstacle == index
        drift[here] = obstacle.velocity_at(contacts.point[here])
    return drift


def _gap_velocity(gap: Floats, dt: float, beta: float, v_max: float) -> Floats:
    return np.where(gap >= 0.0, gap / dt, np.maximum(beta * gap / dt, -v_max))


@jit
def _csr_blocks(
    frames: Floats, fibre_a: Ints, fibre_b: Ints, jacobian_a: Floats, jacobian_b: Floats
) -> tuple[Floats, Ints, Ints]:
    """CSR arrays (data, indices, indptr): three rows a contact, one block a rod, A before B."""
    n, _, D = jacobian_a.shape
    width = np.where(fibre_b >= 0, 2 * D, D)
    indptr = np.zeros(3 * n + 1, np.int64)
    indptr[1:] = np.cumsum(np.repeat(width, 3))
    data, indices = np.empty(indptr[-1]), np.empty(indptr[-1], np.int64)
    _fill_csr(frames, fibre_a, fibre_b, jacobian_a, jacobian_b, indptr, data, indices)
    return data, indices, indptr


@jit_lean
def _fill_csr(
    frames: Floats,
    fibre_a: Ints,
    fibre_b: Ints,
    jacobian_a: Floats,
    jacobian_b: Floats,
    indptr: Ints,
    data: Floats,
    indices: Ints,
) -> None:
    n, _, D = jacobian_a.shape
    for i in range(n):
        for row in range(3):
            at = indptr[3 * i + row]
            for column in range(D):
                data[at + column] = _component(frames[i, row], jacobian_a[i], column)
                indices[at + column] = fibre_a[i] * D + column
                if fibre_b[i] >= 0:
                    data[at + D + column] = -_component(frames[i, row], jacobian_b[i], column)
                    indices[at + D + column] = fibre_b[i] * D + column


@jit_lean
def _component(direction: Floats, jacobian: Floats, column: int) -> float:
    return (
        direction[0] * jacobian[0, column]
        + direction[1] * jacobian[1, column]
        + direction[2] * jacobian[2, column]
    )
