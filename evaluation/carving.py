"""Holes carved into scans of sound roads: each ray that met the road inside goes on to the hole's floor or wall."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from detector.arrays import Float32Array
from detector.pipeline import detect, estimate_sensor_height
from detector.road.robust import fit_tukey
from detector.types import DetectorInput
from simulator.shapes.pothole import pothole
from simulator.shapes.relief import Relief
from vehicle_client.sources.files import read_cloud

FloatArray = NDArray[np.float64]

# Sizes (length, width, depth) and distances of the table.
SIZES_M = ((0.60, 0.45, 0.10), (0.90, 0.70, 0.15))
DISTANCES_M = (10.0, 15.0, 20.0)
# Offsets across the lane that are tried in turn.
OFFSETS_M = (0.0, -0.6, 0.6)
# The road around the place must be seen, flat and free: its plane within this radius, its hits this near to it.
AROUND_M, FLAT_M = 1.2, 0.04
MIN_AROUND_HITS, MIN_FLAT_SHARE = 12, 0.97
STEP_M = 0.005
# A hole is shown by at least so many hits so far below the road: fewer, or shallower, are as many dips of any asphalt.
SHOWN_HITS, DEEP_M = 3, 0.02
NEAR_M = 0.6
PATTERNS = ("kitti_sequence/velodyne/*.bin", "kitti_drive/*.laz")


@dataclass(frozen=True, slots=True)
class Carved:
    """A scan with one hole in it: points (N, 3) in `sensor`, the hole's middle (2,), and how many of its hits lie
    deeper than 2 cm: a ring that meets the hole on its far slope ends above that, as on sound asphalt."""

    points_m: Float32Array
    centre_m: FloatArray
    deep_hits: int

    @property
    def is_shown(self) -> bool:
        """Whether the scan has enough of the hole to be told from the road."""
        return self.deep_hits >= SHOWN_HITS


def carve(points_m: Float32Array, relief: Relief, centre_m: FloatArray, yaw_rad: float) -> Carved | None:
    """The scan with a hole of the relief's shape about a place (2,) in `sensor`; None where no free road is seen."""
    points = points_m.astype(np.float64)
    away = np.hypot(*(points[:, :2] - centre_m).T)
    around = np.flatnonzero(away < AROUND_M)
    if around.size < MIN_AROUND_HITS:
        return None
    plane = _plane(points[around], centre_m)
    over = points[around, 2] - _height(plane, points[around, :2], centre_m)
    on_road = around[np.abs(over) < FLAT_M]
    if on_road.size < MIN_FLAT_SHARE * around.size:
        return None
    moved = points.copy()
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    deep_hits = 0
    for i in on_road:
        reached = _reached(points[i], relief, centre_m, (cos, sin), plane)
        if reached is not None:
            moved[i] = reached
            deep_hits += _below(plane, reached, centre_m) - _below(plane, points[i], centre_m) > DEEP_M
    return Carved(moved.astype(np.float32), centre_m, deep_hits)


def _plane(points: FloatArray, centre_m: FloatArray) -> FloatArray:
    xy = points[:, :2] - centre_m
    terms = np.concatenate([np.ones((len(xy), 1)), xy], axis=1)
    return fit_tukey(terms, points[:, 2], np.ones(len(xy)), cutoff_sd=4.685, floor_sd=0.005)


def _height(plane: FloatArray, xy_m: FloatArray, centre_m: FloatArray) -> FloatArray:
    return np.asarray(plane[0] + (xy_m - centre_m) @ plane[1:])


def _below(plane: FloatArray, point: FloatArray, centre_m: FloatArray) -> float:
    return float(_height(plane, point[:2], centre_m) - point[2])


def _reached(
    hit: FloatArray, relief: Relief, centre_m: FloatArray, turn: tuple[float, float], plane: FloatArray
) -> FloatArray | None:
    """Where a ray from the origin that hit the road ends in the hole; None if it hit beside it.

    The hit's own deviation from the plane, its noise, stays with it.
    """
    direction = hit / np.linalg.norm(hit)
    reach = np.arange(0.0, 2.0 * relief.reach_m / max(math.hypot(direction[0], direction[1]), 0.1), STEP_M)
    path = hit + reach[:, None] * direction
    dx, dy = (path[:, :2] - centre_m).T
    depth = -relief.height_at(turn[0] * dx + turn[1] * dy, turn[0] * dy - turn[1] * dx)
    if depth[0] <= 0.0:
        return None
    below = _height(plane, path[:, :2], centre_m) - path[:, 2]
    ended = np.flatnonzero(below - below[0] >= depth)
    return np.asarray(path[ended[0]]) if ended.size else None


@dataclass(frozen=True, slots=True)
class CarvedScore:
    """By (length, distance): holes that were found, that were carved where the road was free, that the scan shows at
    all, and of those the found ones."""

    found: dict[tuple[float, float], int]
    tried: dict[tuple[float, float], int]
    shown: dict[tuple[float, float], int]
    found_of_shown: dict[tuple[float, float], int]


def scans(data: Path) -> list[Path]:
    """The recorded sweeps under a folder; FileNotFoundError if there is none."""
    found = [path for pattern in PATTERNS for path in sorted(data.glob(pattern))]
    if not found:
        raise FileNotFoundError(f"no scan like {' or '.join(PATTERNS)} under {data}")
    return found


def read_scan(path: Path) -> Float32Array:
    """Points (N, 3) in `sensor` of a KITTI sweep, binary or LAZ; SourceError naming the file if it cannot be read."""
    return read_cloud(path).points_m


def run(paths: Sequence[Path], seed: int) -> Iterator[CarvedScore]:
    """The score so far after every scan: one hole of each size at each distance, in a scan of its own."""
    score = CarvedScore({}, {}, {}, {})
    for number, path in enumerate(paths):
        points = read_scan(path)
        height_m = estimate_sensor_height(points)
        for size in SIZES_M:
            for distance in DISTANCES_M:
                shape = pothole(seed * 1000 + number, *size)
                carved = _somewhere(points, shape, distance, np.random.default_rng([seed, number]))
                if carved is not None:
                    key = (size[0], distance)
                    score.tried[key] = score.tried.get(key, 0) + 1
                    is_found = _is_found(carved, height_m)
                    score.found[key] = score.found.get(key, 0) + is_found
                    score.shown[key] = score.shown.get(key, 0) + carved.is_shown
                    score.found_of_shown[key] = score.found_of_shown.get(key, 0) + (is_found and carved.is_shown)
        yield score


def _somewhere(points_m: Float32Array, shape: Relief, distance_m: float, rng: np.random.Generator) -> Carved | None:
    for offset in rng.permutation(OFFSETS_M):
        centre = np.array([distance_m + rng.uniform(-0.5, 0.5), offset])
        carved = carve(points_m, shape, centre, float(rng.uniform(-0.6, 0.6)))
        if carved is not None:
            return carved
    return None


def _is_found(carved: Carved, height_m: float) -> bool:
    obstacles = detect(DetectorInput(carved.points_m, height_m)).obstacles
    return any(o.kind.is_negative and np.hypot(*(o.centre_m[:2] - carved.centre_m)) < NEAR_M for o in obstacles)
