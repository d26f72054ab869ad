"""Contact-local frames (N, T1, T2) from unit normals."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["contact_frames"]


def contact_frames(normal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Complete unit normals (m, 3) to right-handed orthonormal frames (m, 3, 3) with rows N, T1, T2.

    Branchless construction of [Duff et al. 2017, Building an orthonormal basis, revisited, JCGT 6(1)]:
    a function of the normal alone, continuous except where its z component changes sign.
    """
    x, y, z = normal.T
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    frames = np.empty((len(normal), 3, 3))
    frames[:, 0] = normal
    frames[:, 1] = np.stack((1.0 + sign * x * x * a, sign * b, -sign * x), axis=1)
    frames[:, 2] = np.stack((b, sign + y * y * a, -y), axis=1)
    return frames
