"""Quaternions of rotations, for the files that want them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

FloatArray = NDArray[np.float64]


def quaternion(a_from_b: FloatArray) -> tuple[float, float, float, float]:
    """Unit quaternion (x, y, z, w) of a (4, 4) rigid transform, with w not negative."""
    x, y, z, w = Rotation.from_matrix(a_from_b[:3, :3]).as_quat(canonical=True).tolist()
    return x, y, z, w
