"""Whether a sweep shows a road at all, so that "nothing on the road" and "no road in view" can be told apart."""

from __future__ import annotations

import numpy as np
from numba import njit

from detector.arrays import FloatArray

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
    near, on_road, cells = _counts(along_m, across_m, residual_m)
    return bool(on_road >= MIN_SHARE * near and cells >= MIN_CELLS)


@njit(cache=True, nogil=True)
def _counts(along: FloatArray, across: FloatArray, residual: FloatArray) -> tuple[int, int, int]:
    """Points ahead near the road's surface, those on it, and the number of cells that hold one of these."""
    near, on_road, chosen = 0, 0, np.empty(len(along), dtype=np.int64)
    for i in range(len(along)):
        if along[i] > 0.0 and abs(residual[i]) < BAND_M:
            near += 1
            if abs(residual[i]) < ROAD_BAND_M:
                chosen[on_road] = i
                on_road += 1
    if on_road == 0:
        return near, 0, 0
    chosen = chosen[:on_road]
    first, right = along[chosen].min(), across[chosen].min()
    rows = int((along[chosen].max() - first) / CELL_M) + 1
    columns = int((across[chosen].max() - right) / CELL_M) + 1
    is_hit = np.zeros((rows, columns), dtype=np.bool_)
    for k in chosen:
        is_hit[int((along[k] - first) / CELL_M), int((across[k] - right) / CELL_M)] = True
    return near, on_road, is_hit.sum()
