"""How a simulated LiDAR compares with real scans: the same figures, computed by the same code, of both."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simulator.mesh import pose
from simulator.motion import Standing
from simulator.readings import Sweep
from simulator.sensors.lidar import LidarModel
from simulator.streets.street import LANE_CENTRE_M
from simulator.world import World

FloatArray = NDArray[np.float64]

DISTANCES_M = (5.0, 7.5, 10.0, 15.0, 20.0, 30.0, 40.0)
"""Bands of road ahead whose density of points is compared."""

CORRIDOR_M = 1.25
"""Half of the strip of road ahead: inside one lane, without kerbs."""

STRIPS_M = (-2.0, 0.0, 2.0)
"""Middles of the strips in which road is looked for, to the left of the sensor."""

ON_ROAD_M = 0.12
"""Points this near to the plane of the road count as road: more than crown and noise, less than a kerb."""


OWN_CAR_M = 2.0
"""Nothing but the carrying car is so near; simulated sensors do not see it."""


class ComparisonError(ValueError):
    """A real scan cannot be used; the message names the file."""


@dataclass(frozen=True, slots=True)
class Scan:
    """One turn: returns (N, 3) metres in the frame `sensor`, ring (N,) from below, intensity (N,) in [0, 1].

    Within a ring points follow the rotation. `channels` is the number of rings.
    """

    points_m: FloatArray
    ring: NDArray[np.intp]
    intensity: FloatArray
    channels: int


@dataclass(frozen=True, slots=True)
class Figures:
    """What is compared; densities per square metre of each band of `DISTANCES_M`, NaN where no road is seen."""

    points: float
    columns: float
    missing_share: float
    elevations_deg: FloatArray
    ring_heights_m: FloatArray
    points_per_ring: FloatArray
    sensor_height_m: float
    road_density: FloatArray
    road_noise_m: float
    road_intensity: FloatArray
    ranges_m: FloatArray
    incidence_deg: FloatArray


def read_kitti(path: Path) -> Scan:
    """A scan of KITTI's (float32 x y z reflectance), whose points are sorted by ring from above, without its number.

    Each ring begins where the azimuth passes from right to left ahead of the car.
    """
    points = _read(path, 4)
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    begins = np.flatnonzero((azimuth[:-1] < 0) & (azimuth[1:] >= 0) & (np.diff(azimuth) < math.pi)) + 1
    if len(begins) != 63:
        raise ComparisonError(f"{path}: {len(begins) + 1} rings instead of the 64 of an HDL-64E")
    ring = 63 - np.searchsorted(begins, np.arange(len(points)), side="right")
    return Scan(points[:, :3], ring, points[:, 3], 64)


def read_nuscenes(path: Path) -> Scan:
    """A sweep of nuScenes (float32 x y z intensity ring; x right, y ahead) as its sensor saw it.

    The file holds every ray by column, moved to where the car was at the turn's end. A ray that did not return has
    range zero, so that those show how far the sensor itself was moved; its own car lies within `OWN_CAR_M`.
    """
    rows = _read(path, 5)
    if len(rows) % 32:
        raise ComparisonError(f"{path}: is not a sweep of 32 rings, every ray of it")
    try:
        moved = _moved(rows[:, :3], np.arange(len(rows)) // 32)
    except ComparisonError as error:
        raise ComparisonError(f"{path}: {error}") from error
    points, ring = rows[:, :3] - moved, rows[:, 4].astype(np.intp)
    seen = np.linalg.norm(points, axis=1) > OWN_CAR_M
    return Scan(points[seen] @ [[0, -1, 0], [1, 0, 0], [0, 0, 1]], ring[seen], rows[seen, 3] / 255, 32)


def _moved(points_m: FloatArray, column: NDArray[np.intp]) -> FloatArray:
    """Shift (N, 3) of the sensor at each ray's column: a line through the rays without return, found robustly."""
    at = np.flatnonzero(np.linalg.norm(points_m, axis=1) < 1.0)
    if len(at) < 100:
        raise ComparisonError("holds no rays without return, which tell how the car moved")
    for limit_m in (0.1, 0.03, 0.01):
        lines = np.polyfit(column[at], points_m[at], 1)
        shift: FloatArray = column[:, None] * lines[0] + lines[1]
        apart = np.linalg.norm(points_m - shift, axis=1)
        at = np.flatnonzero(apart < max(limit_m, float(np.median(apart[at]))))
    return shift


def scan_of(sweep: Sweep, channels: int) -> Scan:
    """A simulated turn as a scan."""
    return Scan(
        sweep.points_m.astype(np.float64),
        sweep.ring.astype(np.intp),
        sweep.intensity.astype(np.float64),
        channels,
    )


def simulated(world: World, lidar: LidarModel, turns: int, seed: int) -> list[Scan]:
    """Turns of a sensor that stands in the right lane, ten metres further each time."""
    rng = np.random.default_rng(seed)
    scans = []
    for turn in range(turns):
        standing = Standing(pose(60.0 + 10.0 * turn, LANE_CENTRE_M, lidar.height_m))
        scans.append(scan_of(world.sweep(lidar, standing, 0.0, rng), lidar.channels))
    return scans


def figures(scans: list[Scan]) -> Figures:
    """Means over the scans of one sensor; `ValueError` if there are none."""
    if not scans:
        raise ValueError("no scans to compute figures of")
    channels = scans[0].channels
    elevation, height = _cones(scans)
    roads = [_road(scan) for scan in scans]
    per_ring = np.mean([np.bincount(scan.ring, minlength=channels) for scan in scans], axis=0)
    columns = float(np.mean([_columns(scan) for scan in scans]))
    points = float(np.mean([len(scan.points_m) for scan in scans]))
    return Figures(
        points=points,
        columns=columns,
        missing_share=1 - points / (columns * channels),
        elevations_deg=np.degrees(elevation),
        ring_heights_m=height,
        points_per_ring=per_ring,
        sensor_height_m=float(np.median([road.height_m for road in roads])),
        road_density=np.mean([_open_density(scan) for scan in scans], axis=0),
        road_noise_m=float(np.median([_noise(scan, road) for scan, road in zip(scans, roads, strict=True)])),
        road_intensity=np.quantile(
            np.concatenate([scan.intensity[road.near] for scan, road in zip(scans, roads, strict=True)]),
            [0.1, 0.5, 0.9],
        ),
        ranges_m=np.quantile(_all_ranges(scans), [0.1, 0.25, 0.5, 0.75, 0.9, 0.99]),
        incidence_deg=np.quantile(
            np.concatenate([_incidence(scan) for scan in scans[:2]]), [0.1, 0.25, 0.5, 0.75, 0.9]
        ),
    )


@dataclass(frozen=True, slots=True)
class _Road:
    """The plane of the road z = a x + b y - height ahead of a sensor, and which points of a scan lie on it."""

    height_m: float
    on: NDArray[np.bool_]
    near: NDArray[np.bool_]


def _road(scan: Scan) -> _Road:
    x, y, z = scan.points_m.T
    ahead = (np.abs(y) < CORRIDOR_M) & (x > DISTANCES_M[0]) & (x < DISTANCES_M[-1])
    # The road is the lowest broad thing ahead: a start that most points of the nearest band agree on.
    start = ahead & (x < 2 * DISTANCES_M[0])
    if start.sum() < 20:
        raise ComparisonError("a scan sees no road five to ten metres ahead")
    plane, fitted = np.array([0.0, 0.0, np.median(z[start])]), start
    design = np.stack([x, y, np.ones_like(x)], axis=1)
    for limit_m, reach_m in ((0.3, 10.0), (ON_ROAD_M, 15.0), (ON_ROAD_M, 25.0), (ON_ROAD_M, 40.0)):
        fitted = ahead & (x < reach_m) & (np.abs(z - design @ plane) < limit_m)
        plane = np.linalg.lstsq(design[fitted], z[fitted], rcond=None)[0]
    on = ahead & (np.abs(z - design @ plane) < ON_ROAD_M)
    return _Road(-float(plane[2]), on, on & (x < 2 * DISTANCES_M[1]))


def _density(scan: Scan, road: _Road) -> FloatArray:
    """Road points a square metre in each band ahead."""
    count, _ = np.histogram(scan.points_m[road.on, 0], DISTANCES_M)
    return np.asarray(count / (np.diff(DISTANCES_M) * 2 * CORRIDOR_M))


def _open_density(scan: Scan) -> FloatArray:
    """Greatest density of each band over strips ahead and behind, beside each other: where traffic hides it least."""
    densities = []
    for aside_m, forward in itertools.product(STRIPS_M, (1.0, -1.0)):
        points = (scan.points_m - [0.0, aside_m, 0.0]) * [forward, forward, 1.0]
        strip = replace(scan, points_m=points)
        try:
            densities.append(_density(strip, _road(strip)))
        except ComparisonError:
            continue  # something stands on this strip
    return np.asarray(np.max(densities, axis=0))


def _noise(scan: Scan, road: _Road) -> float:
    """Standard deviation of the range, from second differences along the rings on the road ahead.

    A smooth surface cancels in r[i-1] - 2 r[i] + r[i+1], whose variance is six times that of one range; the median
    keeps out what is no smooth surface.
    """
    index = np.flatnonzero(road.near)
    index = index[np.lexsort((index, scan.ring[index]))]
    ring, range_m = scan.ring[index], np.linalg.norm(scan.points_m[index], axis=1)
    together = (ring[2:] == ring[:-2]) & (np.abs(range_m[2:] - range_m[:-2]) < 0.5)
    second = (range_m[:-2] - 2 * range_m[1:-1] + range_m[2:])[together]
    return float(1.4826 * np.median(np.abs(second)) / math.sqrt(6)) if len(second) else math.nan


def _columns(scan: Scan) -> float:
    """Rays of one ring in a turn: from the mean step between returns that follow each other at once."""
    azimuth = np.arctan2(scan.points_m[:, 1], scan.points_m[:, 0])
    order = np.argsort(scan.ring, kind="stable")
    step = np.abs(np.diff(azimuth[order]))[np.diff(scan.ring[order]) == 0]
    step = step[step < math.pi]
    return float(2 * math.pi / np.mean(step[step < 1.4 * np.median(step)]))


def _cones(scans: list[Scan]) -> tuple[FloatArray, FloatArray]:
    """Elevation (channels,) rad and height (channels,) m of each ring's light: z = rho tan(elevation) + height.

    NaN for a ring without points.
    """
    points = np.concatenate([scan.points_m for scan in scans])
    ring = np.concatenate([scan.ring for scan in scans])
    rho = np.hypot(points[:, 0], points[:, 1])
    lines = np.full((scans[0].channels, 2), np.nan)
    for number in range(scans[0].channels):
        one = ring == number
        if one.sum() < 50 or np.ptp(rho[one]) < 1.0:
            continue  # a line needs points near and far
        for _ in range(3):
            line = np.polyfit(rho[one], points[one, 2], 1, w=1 / rho[one])
            off = np.abs(points[:, 2] - np.polyval(line, rho)) / np.maximum(rho, 1e-3)
            one &= off <= 3 * np.median(off[one]) + 1e-6
        lines[number] = line
    for missing in np.flatnonzero(np.isnan(lines[:, 0])):  # seen at one distance only: from its neighbours' height
        one = ring == missing
        known = np.flatnonzero(np.isfinite(lines[:, 1]))
        if one.any() and len(known):
            height_m = lines[known[np.argmin(np.abs(known - missing))], 1]
            lines[missing] = np.median((points[one, 2] - height_m) / rho[one]), height_m
    return np.arctan(lines[:, 0]), lines[:, 1]


def _all_ranges(scans: list[Scan]) -> FloatArray:
    return np.concatenate([np.linalg.norm(scan.points_m, axis=1) for scan in scans])


def _incidence(scan: Scan) -> FloatArray:
    """Angle between ray and surface in degrees (N,), 0 seen squarely; normals from 20 neighbours."""
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(scan.points_m))
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(20))
    rays = scan.points_m / np.linalg.norm(scan.points_m, axis=1, keepdims=True)
    cosine = np.abs(np.sum(np.asarray(cloud.normals) * rays, axis=1))
    return np.asarray(np.degrees(np.arccos(np.clip(cosine, 0, 1))))


def _read(path: Path, columns: int) -> FloatArray:
    try:
        values = np.fromfile(path, dtype=np.float32)
    except OSError as error:
        raise ComparisonError(f"{path}: cannot be read: {error.strerror}") from error
    if len(values) == 0 or len(values) % columns or not np.isfinite(values).all():
        raise ComparisonError(f"{path}: is not a scan of {columns} finite float32 values a point")
    return values.reshape(-1, columns).astype(np.float64)
