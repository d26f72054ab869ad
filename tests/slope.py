"""A rod on a slope: the scene whose outcome everybody knows."""

import numpy as np
from scipy.spatial.transform import Rotation

from fibercontact.contact.obstacles import Plane
from fibercontact.rods.model import circular_rods, rest_state
from fibercontact.simulation.scene import Body, Scene

UP = np.array([0.0, 0.0, 1.0])


def incline(theta, mu, steps=60, dt=2e-3):
    """A free rod laid along the slope of a plane inclined by theta."""
    turn = Rotation.from_rotvec([0.0, theta, 0.0]).as_matrix()
    rods = circular_rods(
        length=0.1, radius=1e-3, young=1e8, poisson=0.3, density=1000.0, elements=3, free=True
    )
    return Scene(
        name="incline",
        description="A rod on a slope.",
        rods=rods,
        state=rest_state(rods, turn @ [0.0, 0.0, 1e-3], turn),
        bodies=[Body(np.zeros(3), obstacles=[Plane(np.zeros(3), turn @ UP)])],
        carrier=np.zeros(1, dtype=np.int64),
        dt=dt,
        steps=steps,
        mu_fibres=0.0,
        mu_obstacles=mu,
        segments=6,
        tolerance=1e-8,
    )
