"""Obstacles in what the last sweeps saw together: farther than one sweep shows them, and surer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from detector.arrays import FloatArray
from detector.errors import DetectorError
from detector.obstacles.clusters import Cluster
from detector.obstacles.confidence import GRID_HOLE_WEIGHTS, GRID_RISE_WEIGHTS
from detector.obstacles.recognition import recognise
from detector.obstacles.verification import Candidates, candidates_of, likely
from detector.passes.accumulator import Accumulator
from detector.passes.height_grid import deviations_over
from detector.road.corridor import Corridor
from detector.road.deviations import Deviations
from detector.road.ground import from_road_coordinates
from detector.types import DetectedObstacle, DetectorInput, FrameDetection

# Deeper than manhole covers sink (2 cm), and the same the other way.
MIN_RELIEF_M = 0.025
FLAG_SD = 3.0
# What look like gutters on a recorded drive is 3 to 3.6 cm deep, and lasts as holes do; what is shallower has to be
# seen by a single sweep. From farther away rays end on a hole's far slope, and its depth is not known yet.
MIN_HOLE_RELIEF_M, DEPTH_KNOWN_M = 0.0375, 9.0
# What lies behind the rear axle was judged while it lay ahead.
LEAST_ALONG_M = -2.0
# What ten sweeps agree on is asked to be surer than what one shows: it is looked at ten times as often.
MIN_CONFIDENCE = 0.94
# Boxes this far apart are two obstacles.
SAME_M = 0.3
# Cells at the strip's border are half kerb.
EDGE_MARGIN_M = 0.15


def detect_over_frames(
    state: Accumulator, sweep: DetectorInput, detection: FrameDetection
) -> tuple[DetectedObstacle, ...]:
    """Obstacles in the cells of the state's last sweeps, and what the latest one is as sure of, in its frame `sensor`.

    `sweep` and `detection` are the latest, already accumulated. Raises DetectorError without `odom_from_sensor` or for
    a survey, which has no corridor.
    """
    if sweep.odom_from_sensor is None or sweep.sensor_height_m is None or detection.corridor is None:
        raise DetectorError("sweeps are put together along a road: odom_from_sensor and sensor_height_m are needed")
    if not state.recent:
        return ()
    corridor = detection.corridor
    sensor_from_odom: FloatArray = np.asarray(np.linalg.inv(sweep.odom_from_sensor), dtype=np.float64)
    deviations = deviations_over(state.recent, sensor_from_odom, corridor, sweep.sensor_height_m)
    holes, rises = grid_candidates(deviations, corridor)
    clusters = likely(holes, GRID_HOLE_WEIGHTS, MIN_CONFIDENCE) + likely(rises, GRID_RISE_WEIGHTS, MIN_CONFIDENCE)
    found = [_obstacle(deviations, cluster, corridor, len(state.recent)) for cluster in clusters]
    together = [obstacle for obstacle in found if not _is_gutter(obstacle)]
    alone = [o for o in detection.obstacles if o.confidence >= MIN_CONFIDENCE and not _is_among(o, together)]
    return (*together, *alone)


def _is_gutter(obstacle: DetectedObstacle) -> bool:
    near = np.hypot(*obstacle.centre_m[:2]) < DEPTH_KNOWN_M
    return bool(near and obstacle.kind.is_negative and obstacle.relief_m < MIN_HOLE_RELIEF_M)


def _is_among(obstacle: DetectedObstacle, others: list[DetectedObstacle]) -> bool:
    """Whether one of the others is the same obstacle."""
    return any(
        other.kind.is_negative == obstacle.kind.is_negative
        and np.hypot(*(other.centre_m - obstacle.centre_m)[:2]) < SAME_M + 0.5 * (other.length_m + obstacle.length_m)
        for other in others
    )


def grid_candidates(deviations: Deviations, corridor: Corridor) -> tuple[Candidates, Candidates]:
    """Clusters of low and of high cells."""
    inside = deviations.across_m < corridor.left_m - EDGE_MARGIN_M
    inside &= deviations.across_m > corridor.right_m + EDGE_MARGIN_M
    inside &= deviations.along_m > LEAST_ALONG_M
    limit = np.maximum(FLAG_SD * deviations.noise_m, MIN_RELIEF_M)
    low, high = inside & (deviations.residual_m < -limit), inside & (deviations.residual_m > limit)
    return candidates_of(deviations, low, True, corridor), candidates_of(deviations, high, False, corridor)


def _obstacle(deviations: Deviations, cluster: Cluster, corridor: Corridor, frames: int) -> DetectedObstacle:
    """The obstacle of a cluster of cells in the frame `sensor`: they lie on the long profile plus their residual."""
    along, across, residual, noise = (
        values[cluster.indices]
        for values in (deviations.along_m, deviations.across_m, deviations.residual_m, deviations.noise_m)
    )
    xy = from_road_coordinates(along, across + corridor.offset_m(along), corridor.curvature_per_m)
    z = corridor.height_m(along) - deviations.sensor_height_m + residual
    cells = replace(cluster, indices=np.arange(len(along)))
    return replace(recognise(np.concatenate([xy, z[:, None]], axis=1), residual, noise, cells), frames=frames)
