"""Whether a sweep shows a road at all, so that "nothing on the road" and "no road in view" can be told apart."""

from __future__ import annotations

import numpy as np

from detector.types import FloatArray

# What lies farther from a surface than this stands on it or is not part of it.
BAND_M = 0.3
# Asphalt, cobbles and the errors of a surface through them: half of what is near a road lies within it. Of leaves or
# rain, spread evenly over the band, a sixth does.
ROAD_BAND_M = 0.05
MIN_SHARE = 0.5
# Square metres ahead of the car with hits on the road: a lane's width over its braking distance at walking pace.
MIN_CELLS = 12
CELL_M = 1.0


def sees_road(along_m: FloatArray, across_m: FloatArray, residual_m: FloatArray) -> bool:
    """Whether points (N,) of the corridor, at distances along and offsets across, lie on a road ahead of the car.

    `residual_m` (N,) are their heights over the surface fitted to them, which exists for leaves and walls too: of a
    road most of what is near it lies on it, and over some area.
    """
    near = (along_m > 0.0) & (np.abs(residual_m) < BAND_M)
    on_road = near & (np.abs(residual_m) < ROAD_BAND_M)
    if not on_road.any() or on_road.sum() < MIN_SHARE * near.sum():
        return False
    return _cells(along_m[on_road], across_m[on_road]) >= MIN_CELLS


def _cells(along_m: FloatArray, across_m: FloatArray) -> int:
    """Number of cells that hold a point of a corridor (N,)."""
    row, column = ((v - v.min()) / CELL_M for v in (along_m, across_m))
    columns = int(column.max()) + 1
    return int(np.count_nonzero(np.bincount(row.astype(np.int64) * columns + column.astype(np.int64))))
