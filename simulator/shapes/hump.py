"""Rises of the road itself: bumps as over a tree's root, and speed humps across a lane."""

from __future__ import annotations

import math
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from simulator.shapes.outline import local_grid, noise, outline_radius, smoothstep
from simulator.shapes.relief import GRID_STEP_M, Material, Relief

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

RAMP_GRADIENT = 1 / 12
"""TRL report 186 found ramps of 1:10 to 1:15 to bring cars below 20 mph at a height of 75 mm."""

SIDE_TAPER_M = 0.30
"""Humps end in a taper at the kerb, which leaves the channel open for water."""


BUMP_LIMITS = {"length_m": (0.1, 5.0), "width_m": (0.1, 5.0), "height_m": (0.005, 0.5)}

MARK_LENGTH_M, MARK_PERIOD_M = 0.75, 0.80
"""Size of the painted triangles along and across the road."""


class HumpProfile(StrEnum):
    """Section of a speed hump along the road."""

    SINUSOIDAL = "sinusoidal"
    ROUND_TOP = "round-top"
    FLAT_TOP = "flat-top"


def bump(seed: int, length_m: float, width_m: float, height_m: float) -> Relief:
    """Smooth rise of the road itself, as over a tree's root; `ValueError` for sizes beyond `BUMP_LIMITS`."""
    for (name, (low, high)), value in zip(BUMP_LIMITS.items(), (length_m, width_m, height_m), strict=True):
        if not low <= value <= high:
            raise ValueError(f"{name} of a bump must be between {low} and {high}, not {value}")
    rng = np.random.default_rng(seed)
    x_m, y_m = local_grid(length_m, width_m, margin=1.1)
    rho = outline_radius(rng, x_m, y_m, length_m, width_m)
    rise = smoothstep((1 - rho) / 0.75) * (1 + 0.05 * noise(rng, rho.shape, 0.10))
    return Relief(height_m * rise / rise.max(), rho < 1, GRID_STEP_M)


def speed_hump(
    profile: HumpProfile = HumpProfile.ROUND_TOP,
    length_m: float = 3.7,
    width_m: float = 3.4,
    height_m: float = 0.075,
) -> Relief:
    """Hump across a lane: x along the road, `width_m` with tapered ends across it.

    Sizes are those of the Highways (Road Humps) Regulations 1999 (Great Britain), regulation 4: 25 to 100 mm high and
    at least 0.9 m long, else `ValueError`; the profiles are those of TRL report 377 (the usual round top: 3.7 m).
    """
    if not (0.025 <= height_m <= 0.100 and 0.9 <= length_m <= 20.0):
        raise ValueError(f"a road hump is 0.025 to 0.1 m high and 0.9 to 20 m long, not {height_m} and {length_m} m")
    if not 2 * SIDE_TAPER_M < width_m <= 10.0:
        raise ValueError(f"a road hump is between {2 * SIDE_TAPER_M} and 10 m wide, not {width_m} m")
    x_m, y_m = local_grid(length_m + 2 * GRID_STEP_M, width_m + 2 * GRID_STEP_M, margin=1.0)
    sides = smoothstep((width_m / 2 - np.abs(y_m)) / SIDE_TAPER_M)
    section = _SECTIONS[profile](np.abs(x_m), length_m, height_m)
    footprint = (np.abs(x_m) < length_m / 2) & (np.abs(y_m) < width_m / 2)
    materials = np.where(footprint, Material.PATCH, Material.ASPHALT).astype(np.uint8)
    materials[_triangles(x_m, y_m, length_m) & (sides > 0.5)] = Material.MARK
    return Relief(np.where(footprint, section * sides, 0.0), footprint, GRID_STEP_M, materials=materials)


def _triangles(x_m: FloatArray, y_m: FloatArray, length_m: float) -> BoolArray:
    """White triangles that point up the near ramp (as diagram 1062 of the British traffic signs regulations)."""
    up = (x_m + length_m / 2 - 0.05) / min(MARK_LENGTH_M, 0.4 * length_m)
    across = np.abs(y_m - MARK_PERIOD_M * np.rint(y_m / MARK_PERIOD_M))
    inside: BoolArray = (up > 0) & (across < 0.45 * MARK_PERIOD_M * (1 - up))
    return inside


def _sinusoidal(x_m: FloatArray, length_m: float, height_m: float) -> FloatArray:
    return np.asarray(height_m * (1 + np.cos(2 * math.pi * x_m / length_m)) / 2)


def _round_top(x_m: FloatArray, length_m: float, height_m: float) -> FloatArray:
    radius_m = (length_m**2 / 4 + height_m**2) / (2 * height_m)
    return np.asarray(np.sqrt(np.maximum(radius_m**2 - x_m**2, 0)) - (radius_m - height_m))


def _flat_top(x_m: FloatArray, length_m: float, height_m: float) -> FloatArray:
    ramp_m = min(height_m / RAMP_GRADIENT, length_m / 3)
    return np.asarray(height_m * np.clip((length_m / 2 - x_m) / ramp_m, 0, 1))


_SECTIONS = {
    HumpProfile.SINUSOIDAL: _sinusoidal,
    HumpProfile.ROUND_TOP: _round_top,
    HumpProfile.FLAT_TOP: _flat_top,
}
