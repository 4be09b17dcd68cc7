"""Volume of a hole: depth over area, however unevenly the points lie."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from detector.arrays import FloatArray, IntArray
from detector.survey.grid import smooth
from detector.survey.road import FINE_CELLS, Relief

# What fills a hole runs out on its apron; what lies below the road farther from the outline is another matter.
APRON_M = 0.035
# Where an apron runs out, fewer than half of its points are told from the road; with this share of them sand lies.
SUPPORTED_SHARE = 0.3
# A straight-edge that levels the filling rides on the road's high points: one standard deviation of its waves.
LEVEL_SD = 1.0


def volume_below(relief: Relief, holes: IntArray, support: NDArray[np.bool_]) -> FloatArray:
    """Volume in m3 (K + 1,) of the holes numbered 1..K in a map (R, C), as sand that is struck off level would show.

    `support` (N,) are the points below the road around the holes. Cells without points take the depth of their
    neighbours; a cell between holes counts for the nearest.
    """
    occupied = (relief.count > 0).astype(np.float64)
    depth, _ = smooth(relief.depth_map_m, occupied, FINE_CELLS)
    share, _ = smooth(relief.grid.mean(relief.cells, support.astype(np.float64), relief.count), occupied, FINE_CELLS)
    supported = share > SUPPORTED_SHARE
    away, (row, column) = distance_transform_edt(holes == 0, return_indices=True)
    counted = (holes > 0) | (supported & (away * relief.grid.cell_m < APRON_M))
    filled = depth[counted] + LEVEL_SD * relief.wave_m
    volume = np.bincount(holes[row, column][counted], weights=filled, minlength=int(holes.max()) + 1)
    return np.asarray(volume * relief.grid.cell_m**2)
