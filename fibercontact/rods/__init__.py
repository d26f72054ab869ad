"""Rods: kinematics from curvatures, dynamics, the linearly implicit step."""

from fibercontact.rods.basis import CLOTHOID, HELIX
from fibercontact.rods.dynamics import (
    Energy,
    advance,
    energy,
    generalised_force,
    inertia_matrix,
    step_system,
    stiffness_matrix,
)
from fibercontact.rods.kinematics import Points, centreline, point_jacobian, prescribed_velocity
from fibercontact.rods.model import Rods, RootMotion, State, circular_rods, dofs, rest_state, still

__all__ = [
    "CLOTHOID",
    "HELIX",
    "Energy",
    "Points",
    "Rods",
    "RootMotion",
    "State",
    "advance",
    "centreline",
    "circular_rods",
    "dofs",
    "energy",
    "generalised_force",
    "inertia_matrix",
    "point_jacobian",
    "prescribed_velocity",
    "rest_state",
    "step_system",
    "stiffness_matrix",
    "still",
]
