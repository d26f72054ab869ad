"""Rods: from curvatures or in maximal coordinates; kinematics, dynamics, implicit steps."""

from fibercontact.rods.air import Drag, slender_drag
from fibercontact.rods.basis import CLOTHOID, HELIX
from fibercontact.rods.discrete_model import (
    DiscreteRods,
    DiscreteState,
    discrete_rods,
    discrete_state,
    discretise,
)
from fibercontact.rods.discrete_step import discrete_energy, discrete_points, implicit_step
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
    "DiscreteRods",
    "DiscreteState",
    "Drag",
    "Energy",
    "Points",
    "Rods",
    "RootMotion",
    "State",
    "advance",
    "centreline",
    "circular_rods",
    "discrete_energy",
    "discrete_points",
    "discrete_rods",
    "discrete_state",
    "discretise",
    "dofs",
    "energy",
    "generalised_force",
    "implicit_step",
    "inertia_matrix",
    "point_jacobian",
    "prescribed_velocity",
    "rest_state",
    "slender_drag",
    "step_system",
    "stiffness_matrix",
    "still",
]
