"""What may enter the detector: finite points in metres, and a guess of the sensor's height where it is unknown."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from detector.arrays import Float32Array, FloatArray, IntArray
from detector.errors import DetectorError
from detector.road.robust import fit_tukey
from detector.types import DetectorInput

# No automotive LiDAR reaches farther.
MAX_RANGE_M = 500.0
# The hits of a road scan have their median within some tens of metres.
MAX_MEDIAN_RANGE_M = 150.0
# Points nearer than this belong to the car itself.
MIN_RANGE_M = 1.5
# A dense patch of road without a viewpoint is never longer; an 80 mm scan in millimetres would be.
MAX_SURVEY_EXTENT_M = 50.0

# Ring of ground around the car in which its plane is searched.
GROUND_RANGE_M = (3.0, 15.0)
GROUND_BAND_M = 0.3
MIN_GROUND_POINTS = 50
HEIGHT_BIN_M = 0.1
PLAUSIBLE_HEIGHT_M = (0.3, 6.0)


def usable_points(sweep: DetectorInput) -> tuple[FloatArray, IntArray]:
    """The points (M, 3) that can be used, as float64, and their indices (M,) in the input.

    Raises DetectorError for arrays that are not (N, 3), for a height that is not positive, and for coordinates that
    cannot be metres.
    """
    if sweep.sensor_height_m is not None and not (np.isfinite(sweep.sensor_height_m) and sweep.sensor_height_m > 0.0):
        raise DetectorError(f"sensor_height_m is {sweep.sensor_height_m}: give the sensor's height over the road, > 0")
    if not np.isfinite(sweep.curvature_per_m):
        raise DetectorError("curvature_per_m is not finite: give 0 where the steering is unknown")
    points = _checked_shape(sweep.points_m)
    if sweep.sensor_height_m is None:
        return _usable_of_survey(points.astype(np.float64))
    usable, indices, finite, far = _usable(points)
    if far > finite / 2:
        raise DetectorError(
            f"half of the points lie more than {MAX_MEDIAN_RANGE_M:.0f} m away, no LiDAR sees such a road: are they "
            "in millimetres or in map coordinates? Metres in the sensor frame are expected"
        )
    return usable, indices


@njit(cache=True, nogil=True)
def _usable(points: FloatArray) -> tuple[FloatArray, IntArray, int, int]:
    """Finite points between car and the end of any LiDAR's reach, their indices, and how many are finite, and far."""
    kept, indices = np.empty((len(points), 3)), np.empty(len(points), dtype=np.int64)
    count, finite, far = 0, 0, 0
    for i in range(len(points)):
        x, y, z = float(points[i, 0]), float(points[i, 1]), float(points[i, 2])
        square = x * x + y * y
        if not (math.isfinite(square) and math.isfinite(z)):
            continue
        finite += 1
        far += square > MAX_MEDIAN_RANGE_M * MAX_MEDIAN_RANGE_M
        if MIN_RANGE_M * MIN_RANGE_M < square < MAX_RANGE_M * MAX_RANGE_M:
            kept[count, 0], kept[count, 1], kept[count, 2] = x, y, z
            indices[count] = i
            count += 1
    return kept[:count], indices[:count], finite, far


def _usable_of_survey(points: FloatArray) -> tuple[FloatArray, IntArray]:
    indices = np.flatnonzero(np.isfinite(points).all(axis=1))
    points = points[indices]
    if indices.size == 0:
        return points, indices
    low, high = np.percentile(points, (1.0, 99.0), axis=0)
    extent = float((high - low).max())
    near = ((points >= low - extent) & (points <= high + extent)).all(axis=1)
    points, indices = points[near], indices[near]
    if extent > MAX_SURVEY_EXTENT_M:
        raise DetectorError(
            f"the points of the survey extend over {extent:.0f} m: are they in millimetres? Metres are expected; for a "
            "LiDAR sweep state sensor_height_m"
        )
    return points, indices


def _checked_shape(points_m: Float32Array) -> NDArray[np.floating]:
    if points_m.ndim != 2 or points_m.shape[1] != 3:
        raise DetectorError(f"points_m has shape {points_m.shape}: (N, 3) is expected")
    return np.ascontiguousarray(points_m, dtype=np.float32 if points_m.dtype == np.float32 else np.float64)


def estimate_sensor_height(points_m: Float32Array) -> float:
    """Height in metres of the sensor above the plane of the road around it, from points (N, 3) in its frame.

    Raises DetectorError where no ground is seen between 3 and 15 m.
    """
    points = _checked_shape(points_m).astype(np.float64)
    range_m = np.hypot(points[:, 0], points[:, 1])
    with np.errstate(invalid="ignore"):
        ring = (range_m > GROUND_RANGE_M[0]) & (range_m < GROUND_RANGE_M[1]) & np.isfinite(points[:, 2])
        ring &= (points[:, 2] < -PLAUSIBLE_HEIGHT_M[0]) & (points[:, 2] > -PLAUSIBLE_HEIGHT_M[1])
    if ring.sum() < MIN_GROUND_POINTS:
        raise DetectorError("no ground between 3 and 15 m around the sensor: state its height (--sensor-height)")
    ground = points[ring]
    edges = np.arange(-PLAUSIBLE_HEIGHT_M[1], 0.0, HEIGHT_BIN_M)
    counts, _ = np.histogram(ground[:, 2], edges)
    mode = edges[int(np.argmax(counts))] + HEIGHT_BIN_M / 2.0
    ground = ground[np.abs(ground[:, 2] - mode) < GROUND_BAND_M]
    terms = np.stack([np.ones(len(ground)), ground[:, 0] / 10.0, ground[:, 1] / 10.0], axis=1)
    return -float(fit_tukey(terms, ground[:, 2], np.ones(len(ground)), cutoff_sd=4.685, floor_sd=0.01)[0])
