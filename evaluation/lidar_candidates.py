"""What the detector sees before it decides: the candidates' features, and whether each was an obstacle."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contract.geometry import Kind
from detector.obstacles.confidence import features
from detector.obstacles.verification import Candidates, candidates_of_sweep
from detector.passes.accumulator import RECENT_FRAMES, Accumulator, accumulate
from detector.passes.height_grid import deviations_over
from detector.passes.over_frames import grid_candidates
from detector.road.corridor import Corridor
from detector.road.deviations import Deviations
from detector.road.ground import road_coordinates
from detector.road.strip import Strip, road_strip
from detector.types import FrameDetection
from evaluation.lidar_course import Course, Moment, in_sensor

FloatArray = NDArray[np.float64]

# A cluster whose middle is this near to an obstacle's outline is it; up to the second it may be, and is left out.
SURE_M, UNSURE_M = 0.35, 1.2


@dataclass(frozen=True, slots=True)
class Sample:
    """Plausible clusters of one sign, of one sweep or over frames: features (C, F), and whether each is an obstacle."""

    is_negative: bool
    over_frames: bool
    features: FloatArray
    is_obstacle: NDArray[np.bool_]


def samples(on: Course, moments: Iterator[Moment]) -> Iterator[Sample]:
    """The candidates of every sweep of a drive, and of the grid once it is full."""
    state = Accumulator()
    for moment in moments:
        sweep = moment.sweep
        if sweep.odom_from_sensor is None or sweep.sensor_height_m is None:
            raise ValueError("a course's sweeps have poses and a sensor height")
        strip = road_strip(sweep.points_m.astype(np.float64), sweep.sensor_height_m, sweep.curvature_per_m)
        deviations, corridor = strip.deviations, strip.corridor
        state = accumulate(state, sweep, _undecided(strip, len(sweep.points_m)))
        for is_negative, flagged in ((True, deviations.below), (False, deviations.above)):
            candidates = candidates_of_sweep(deviations, flagged & strip.in_corridor, is_negative, corridor)
            yield _sample(candidates, deviations, corridor, in_sensor(moment.street_from_sensor, on), on, False)
        if len(state.recent) == RECENT_FRAMES:
            sensor_from_odom: FloatArray = np.asarray(np.linalg.inv(sweep.odom_from_sensor), dtype=np.float64)
            grid = deviations_over(state.recent, sensor_from_odom, corridor, sweep.sensor_height_m)
            for candidates in grid_candidates(grid, corridor):
                yield _sample(candidates, grid, corridor, in_sensor(moment.street_from_sensor, on), on, True)


def _undecided(strip: Strip, count: int) -> FrameDetection:
    """What the accumulator needs of a detection: the residuals."""
    residual = np.full(count, np.nan, dtype=np.float32)
    residual[strip.indices] = strip.deviations.residual_m
    nothing = np.zeros(count, dtype=np.float32)
    return FrameDetection(nothing.astype(np.uint8), nothing, residual, (), strip.corridor)


def _sample(
    candidates: Candidates,
    deviations: Deviations,
    corridor: Corridor,
    centres_m: FloatArray,
    on: Course,
    over_frames: bool,
) -> Sample:
    chosen = np.flatnonzero(candidates.plausible)
    middle = np.array(
        [[deviations.along_m[g].mean(), deviations.across_m[g].mean()] for g in (candidates.groups[c] for c in chosen)]
    ).reshape(-1, 2)
    along, across = road_coordinates(centres_m, corridor.curvature_per_m)
    places = np.stack([along, across - corridor.offset_m(along)], axis=1)
    distance = np.linalg.norm(middle[:, None] - places[None], axis=2)
    distance = distance - 0.5 * np.array([obstacle.shape.length_m for obstacle in on.obstacles])
    nearest = np.argmin(distance, axis=1)
    gap = distance[np.arange(len(chosen)), nearest]
    is_hole = np.array([obstacle.kind is Kind.POTHOLE for obstacle in on.obstacles])[nearest]
    is_obstacle = (gap < SURE_M) & (is_hole == candidates.is_negative)
    sure = is_obstacle | (gap > UNSURE_M)
    return Sample(candidates.is_negative, over_frames, features(candidates.around)[chosen][sure], is_obstacle[sure])
