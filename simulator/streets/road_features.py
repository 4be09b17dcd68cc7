"""Patches, manhole covers and joints as reliefs: what a sound road is uneven with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.shapes.relief import GRID_STEP_M, Relief

FloatArray = NDArray[np.float64]

EDGE_M = 0.02
"""A sawn edge, worn."""

MANHOLE_DIAMETER_M = 0.68
"""Frame of a cover with 600 mm clear opening (EN 124)."""

JOINT_WIDTH_M, JOINT_DEPTH_M = 0.04, 0.008


def patch(rng: np.random.Generator, length_m: float, width_m: float) -> Relief:
    """A rectangle laid up to 12 mm too high or too low, slightly tilted: what utilities leave behind."""
    u, v, inside_m = _rectangle(length_m, width_m)
    offset_m, tilt = rng.uniform(-0.012, 0.012), rng.uniform(-0.004, 0.004, 2)
    height = (offset_m + tilt[0] * u / length_m + tilt[1] * v / width_m) * np.clip(inside_m / EDGE_M, 0, 1)
    return Relief(height, inside_m > 0, GRID_STEP_M)


def manhole(rng: np.random.Generator) -> Relief:
    """A round cover 2 to 20 mm below the road, as it sinks under traffic."""
    half = MANHOLE_DIAMETER_M / 2
    u, v, _ = _rectangle(MANHOLE_DIAMETER_M, MANHOLE_DIAMETER_M)
    inside_m = half - np.hypot(u, v)
    height = -rng.uniform(0.002, 0.020) * np.clip(inside_m / EDGE_M, 0, 1)
    return Relief(height, inside_m > 0, GRID_STEP_M)


def joint(length_m: float) -> Relief:
    """A sealed transverse joint, its length along the local y."""
    _, _, inside_m = _rectangle(JOINT_WIDTH_M, length_m)
    return Relief(-JOINT_DEPTH_M * np.clip(inside_m / (JOINT_WIDTH_M / 2), 0, 1), inside_m > 0, GRID_STEP_M)


def _rectangle(length_m: float, width_m: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Local grid one cell larger than a box, and how far inside the box (negative: outside) each position is."""
    axes = [
        (np.arange(2 * cells + 1) - cells) * GRID_STEP_M
        for cells in (int(np.ceil(side / 2 / GRID_STEP_M)) + 1 for side in (length_m, width_m))
    ]
    u, v = np.meshgrid(*axes)
    return u, v, np.minimum(length_m / 2 - np.abs(u), width_m / 2 - np.abs(v))
