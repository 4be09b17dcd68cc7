"""Intersection over union of the detector's classes with what each ray hit."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from detector.arrays import LabelArray
from detector.types import PointClass
from evaluation.lidar_course import Course, Moment
from simulator.scene.scenery import Surface

# Classes that are told apart: a car half on the kerb is both in and outside the range of the road.
NAMES = ("flat, off the road", "road", "standing", "obstacle on the road")
FLAT, ROAD, STANDING, OBSTACLE, LEFT_OUT = range(5)
CLASS_OF_LABEL = np.zeros(6, dtype=np.int64)
CLASS_OF_LABEL[PointClass.UNCLASSIFIED] = FLAT
CLASS_OF_LABEL[PointClass.SAFE_ROAD] = ROAD
CLASS_OF_LABEL[[PointClass.POSITIVE, PointClass.OUTSIDE]] = STANDING
CLASS_OF_LABEL[[PointClass.NEGATIVE, PointClass.OBSTACLE]] = OBSTACLE

ROAD_SURFACES = (Surface.ROAD, Surface.WATER, Surface.MANHOLE, Surface.ROAD_MARK)
FLAT_SURFACES = (Surface.KERB, Surface.PAVEMENT, Surface.GROUND)
# What is lower is a kerb's, a wheel's foot or grass: neither flat nor standing.
STANDING_HEIGHT_M = 0.3
# Where a vehicle's LiDAR is asked for the road, and where single sweeps are asked for obstacles.
RANGE_M, OBSTACLE_RANGE_M = 40.0, 12.0
# Less of an obstacle's relief than this is its rim: road to any sensor.
RELIEF_M = 0.03


@dataclass(frozen=True, slots=True)
class Confusion:
    """Points counted by (true class, given class)."""

    counts: NDArray[np.int64] = field(default_factory=lambda: np.zeros((4, 4), dtype=np.int64))

    def __add__(self, other: Confusion) -> Confusion:
        return Confusion(self.counts + other.counts)

    def intersection_over_union(self) -> dict[str, float]:
        """By class: points of both over points of either."""
        both = np.diag(self.counts)
        either = self.counts.sum(axis=0) + self.counts.sum(axis=1) - both
        return {name: float(b / max(e, 1)) for name, b, e in zip(NAMES, both, either, strict=True)}


def confusion(moment: Moment, labels: LabelArray, on: Course) -> Confusion:
    """The points of a sweep that have a clear class, by their true and their given one."""
    truth = true_classes(moment, on)
    clear = truth != LEFT_OUT
    counts = np.bincount(truth[clear] * 4 + CLASS_OF_LABEL[labels[clear]], minlength=16)
    return Confusion(counts.reshape(4, 4))


def true_classes(moment: Moment, on: Course) -> NDArray[np.int64]:
    """True class (N,) of the points of a sweep, LEFT_OUT where it has none or lies too far."""
    points = moment.sweep.points_m.astype(np.float64)
    street = points @ moment.street_from_sensor[:3, :3].T + moment.street_from_sensor[:3, 3]
    range_m = np.hypot(points[:, 0], points[:, 1])
    height = street[:, 2] - on.world.street.sound_height(street[:, 0], street[:, 1])
    truth = np.full(len(points), LEFT_OUT)
    surface, placed = moment.truth.surface, moment.truth.obstacle_id > 0
    truth[np.isin(surface, ROAD_SURFACES) & ~placed] = ROAD
    truth[np.isin(surface, FLAT_SURFACES)] = FLAT
    truth[~np.isin(surface, (*ROAD_SURFACES, *FLAT_SURFACES)) & (height > STANDING_HEIGHT_M) & ~placed] = STANDING
    near = range_m < OBSTACLE_RANGE_M
    truth[placed & near & (np.abs(height) > RELIEF_M)] = OBSTACLE
    truth[(range_m > RANGE_M) | (points[:, 0] < -20.0)] = LEFT_OUT
    return truth
