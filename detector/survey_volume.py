"""Volume of a hole: depth over area, however unevenly the points lie."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from detector.survey_grid import smooth
from detector.survey_road import FINE_CELLS, Relief
from detector.types import FloatArray, IntArray


def volume_below(relief: Relief, holes: IntArray, support: NDArray[np.bool_]) -> FloatArray:
    """Volume in m3 (K + 1,) of the holes numbered 1..K in a map (R, C), with what lies below the road around them.

    Cells without points take the depth of their neighbours; each cell counts for the nearest hole.
    """
    depth, _ = smooth(relief.depth_map_m, (relief.count > 0).astype(np.float64), FINE_CELLS)
    mass = relief.grid.mean(relief.cells, support.astype(np.float64), relief.count)
    counted = (mass > 0.0) | (holes > 0)
    row, column = distance_transform_edt(holes == 0, return_distances=False, return_indices=True)
    nearest = holes[row, column]
    volume = np.bincount(nearest[counted], weights=depth[counted], minlength=int(holes.max()) + 1)
    return np.asarray(volume * relief.grid.cell_m**2)
