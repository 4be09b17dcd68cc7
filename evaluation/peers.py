"""The peers that our tables stand beside: what they call an obstacle, in patches of road and in sweeps.

All three ask which points are ground. Their parameters are the documented defaults; those that are lengths are scaled
by the cloud's point spacing in a patch, and stay metres in a sweep. Patchwork++ and CSF look for things that stand on
the ground and take a hole for ground, so they see every cloud a second time upside down; what either view calls an
object counts. All answers are deterministic.

Sources: M. A. Fischler and R. C. Bolles, "Random sample consensus", 1981, and M. Ester et al., "DBSCAN", 1996, both as
in Open3D; S. Lee et al., "Patchwork++", IROS 2022; W. Zhang et al., "An easy-to-use airborne LiDAR data filtering
method based on cloth simulation", Remote Sensing 8(6), 2016.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]
IntArray = NDArray[np.int64]

PatchPeer = Callable[[FloatArray], Mask]
"""Points (N, 3) of a patch of road in any unit, z up -> mask (N,) of those that it calls no road."""

SweepPeer = Callable[[FloatArray, float, Mask], list[IntArray]]
"""Points (N, 3) of a sweep in the `sensor` frame, the sensor's height in metres and the mask (N,) of the points on the
road -> indices of the points of each obstacle there."""

SEED = 1
MOST_OBJECTS = 0.5
SPACING_SAMPLE = 2000
MIN_PATCH_POINTS = 30

# The best in all of 0.25, 0.5, 1 and 1.7 spacings (the tutorial's) on scans of potholes that lie 1 mm below the road:
# smaller ones break at 0.5 mm of noise, greater ones miss the shallow parts.
PLANE_THRESHOLD_SPACINGS = 0.5
# Open3D's tutorial: 1000 trials of 3 points; clusters of 10 points within 0.02 m, 3.3 spacings of its cloud.
PLANE_TRIALS = 1000
CLUSTER_REACH_SPACINGS = 3.3
CLUSTER_POINTS = 10
# Two standard deviations of an automotive LiDAR's range; points of neighbouring rings at 10 m lie 0.5 m apart.
SWEEP_THRESHOLD_M = 0.04
SWEEP_REACH_M = 0.5
SWEEP_CELL_M = 0.1
SWEEP_CLUSTER_POINTS = 3
# What is on the road is lower than a car's bonnet, and no outlier below the road: CSF's manual asks to remove those.
SWEEP_BAND_M = (-0.6, 1.0)

# Neighbours in a sweep of an HDL-64E, for which Patchwork++ is tuned, lie about this far apart at 10 m.
PATCHWORK_SPACING_M = 0.1
PATCHWORK_HEIGHT_M = 1.723
# Its zones begin here.
PATCHWORK_NEAREST_M = 2.7

# The spacing of the airborne clouds of CSF's paper, whose cloth and threshold are its defaults 1 m and 0.5 m.
CSF_SPACING_M = 0.5


def ransac_dbscan(points: FloatArray) -> Mask:
    """Open3D: the plane that most points lie on, then what lies off it in clusters."""
    spacing = point_spacing(points)
    if spacing == 0.0:
        return np.zeros(len(points), dtype=bool)
    off_plane = _off_plane(points / spacing, PLANE_THRESHOLD_SPACINGS)
    clustered = np.zeros(len(points), dtype=bool)
    for cluster in _clusters(points / spacing, off_plane, CLUSTER_REACH_SPACINGS, CLUSTER_POINTS):
        clustered[cluster] = True
    return clustered


def patchwork(points: FloatArray) -> Mask:
    """Patchwork++ on the patch as if it lay before an HDL-64E, and on the patch turned over."""
    spacing = point_spacing(points)
    if spacing == 0.0:
        return np.zeros(len(points), dtype=bool)
    scaled = (points - np.median(points, axis=0)) * (PATCHWORK_SPACING_M / spacing)
    ahead = PATCHWORK_NEAREST_M - float(scaled[:, 0].min()) + PATCHWORK_SPACING_M
    before_sensor = np.array([ahead, 0.0, -PATCHWORK_HEIGHT_M])
    return _either_side(scaled, lambda cloud: _patchwork_objects(cloud + before_sensor))


def cloth(points: FloatArray) -> Mask:
    """CSF on the patch, and on the patch turned over."""
    spacing = point_spacing(points)
    if spacing == 0.0:
        return np.zeros(len(points), dtype=bool)
    scaled = (points - np.median(points, axis=0)) * (CSF_SPACING_M / spacing)
    return _either_side(scaled, lambda cloud: _csf_objects(cloud, resolution_m=1.0, threshold_m=0.5))


PATCH_PEERS: dict[str, PatchPeer] = {"RANSAC + DBSCAN": ransac_dbscan, "Patchwork++": patchwork, "CSF": cloth}
"""Peers on dense patches of road without a viewpoint."""


def sweep_ransac_dbscan(points_m: FloatArray, sensor_height_m: float, on_road: Mask) -> list[IntArray]:
    """Open3D: the plane of the road's points at 4 cm, clusters of what lies off it."""
    chosen = np.flatnonzero(_near_road(points_m, sensor_height_m, on_road))
    off_plane = np.zeros(len(points_m), dtype=bool)
    off_plane[chosen] = _off_plane(points_m[chosen], SWEEP_THRESHOLD_M)
    return _sweep_clusters(points_m, off_plane)


def sweep_patchwork(points_m: FloatArray, sensor_height_m: float, on_road: Mask) -> list[IntArray]:
    """Patchwork++ on the sweep, and on it turned over about the road; clusters of its objects."""
    sensor = np.array([0.0, 0.0, sensor_height_m])
    chosen = np.flatnonzero(_near_road(points_m, sensor_height_m, on_road))
    objects = np.zeros(len(points_m), dtype=bool)
    objects[chosen] = _either_side(
        points_m[chosen] + sensor, lambda cloud: _patchwork_objects(cloud - sensor, sensor_height_m)
    )
    return _sweep_clusters(points_m, objects)


def sweep_cloth(points_m: FloatArray, sensor_height_m: float, on_road: Mask) -> list[IntArray]:
    """CSF on the road's points with a cloth of 0.5 m at 4 cm, and on them turned over; clusters of its objects.

    Its own threshold of 0.5 m is that of airborne scans: nothing on a road is as high.
    """
    chosen = np.flatnonzero(_near_road(points_m, sensor_height_m, on_road))
    objects = np.zeros(len(points_m), dtype=bool)
    objects[chosen] = _either_side(
        points_m[chosen], lambda cloud: _csf_objects(cloud, resolution_m=0.5, threshold_m=SWEEP_THRESHOLD_M)
    )
    return _sweep_clusters(points_m, objects)


SWEEP_PEERS: dict[str, SweepPeer] = {
    "RANSAC + DBSCAN": sweep_ransac_dbscan,
    "Patchwork++": sweep_patchwork,
    "CSF": sweep_cloth,
}
"""Peers on sweeps from a vehicle."""


def point_spacing(points: FloatArray) -> float:
    """Median distance to the nearest other point, over at most 2000 points; 0 where too few points are apart."""
    if len(points) < MIN_PATCH_POINTS:
        return 0.0
    sample = points[:: max(len(points) // SPACING_SAMPLE, 1)]
    distance, _ = cKDTree(points).query(sample, k=2)
    return float(np.median(np.asarray(distance)[:, 1]))


def _either_side(points: FloatArray, objects_of: PatchPeer) -> Mask:
    """Objects of either view; one without a majority of ground is a cloth that hung on what it should have covered."""
    views = (objects_of(points), objects_of(points * np.array([1.0, 1.0, -1.0])))
    believed = [view for view in views if view.sum() <= MOST_OBJECTS * len(points)]
    return np.asarray(np.logical_or.reduce([np.zeros(len(points), dtype=bool), *believed]))


def _near_road(points_m: FloatArray, sensor_height_m: float, on_road: Mask) -> Mask:
    height = points_m[:, 2] + sensor_height_m
    return np.asarray(on_road & (height > SWEEP_BAND_M[0]) & (height < SWEEP_BAND_M[1]))


def _off_plane(points: FloatArray, threshold: float) -> Mask:
    import open3d as o3d

    off = np.zeros(len(points), dtype=bool)
    if len(points) < 3:
        return off
    threads = o3d.utility.get_max_threads()
    # Several threads draw from one stream of random numbers in an order that differs from run to run.
    o3d.utility.set_max_threads(1)
    o3d.utility.random.seed(SEED)
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    _, inliers = cloud.segment_plane(threshold, ransac_n=3, num_iterations=PLANE_TRIALS)
    o3d.utility.set_max_threads(threads)
    off[:] = True
    off[np.asarray(inliers, dtype=np.int64)] = False
    return off


def _clusters(points: FloatArray, chosen: Mask, reach: float, least: int) -> list[IntArray]:
    indices = np.flatnonzero(chosen)
    labels = _dbscan(points[indices], reach, least)
    return [indices[labels == label] for label in range(int(labels.max(initial=-1)) + 1)]


def _sweep_clusters(points_m: FloatArray, chosen: Mask) -> list[IntArray]:
    """Clusters of the cells that points fall into: among the many points of the near field DBSCAN takes seconds."""
    indices = np.flatnonzero(chosen)
    if indices.size == 0:
        return []
    cells, cell_of = np.unique(np.floor(points_m[indices] / SWEEP_CELL_M), axis=0, return_inverse=True)
    labels = _dbscan(cells * SWEEP_CELL_M, SWEEP_REACH_M, 1)[cell_of.ravel()]
    groups = (indices[labels == label] for label in range(int(labels.max()) + 1))
    return [group for group in groups if group.size >= SWEEP_CLUSTER_POINTS]


def _dbscan(points: FloatArray, reach: float, least: int) -> IntArray:
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    return np.asarray(cloud.cluster_dbscan(reach, least), dtype=np.int64)


def _patchwork_objects(points_m: FloatArray, sensor_height_m: float = PATCHWORK_HEIGHT_M) -> Mask:
    import pypatchworkpp

    parameters = pypatchworkpp.Parameters()
    parameters.sensor_height = sensor_height_m
    range_m = np.hypot(points_m[:, 0], points_m[:, 1])
    parameters.max_range = max(parameters.max_range, float(range_m.max(initial=0.0)))
    # It removes reflections by their intensity, which these clouds do not have.
    parameters.enable_RNR = False
    with _silent():
        segmentation = pypatchworkpp.patchworkpp(parameters)
        segmentation.estimateGround(np.column_stack([points_m, np.zeros(len(points_m))]))
    objects = np.zeros(len(points_m), dtype=bool)
    objects[np.asarray(segmentation.getNongroundIndices(), dtype=np.int64)] = True
    # It hands what is nearer back as no ground, without a judgement.
    return np.asarray(objects & (range_m > parameters.min_range))


def _csf_objects(points_m: FloatArray, resolution_m: float, threshold_m: float) -> Mask:
    CSF = _one_threaded_csf()
    objects = np.zeros(len(points_m), dtype=bool)
    if len(points_m) == 0:
        return objects
    cloth_filter = CSF.CSF()
    cloth_filter.params.cloth_resolution = resolution_m
    cloth_filter.params.class_threshold = threshold_m
    ground, others = CSF.VecInt(), CSF.VecInt()
    with _silent():
        cloth_filter.setPointCloud(np.ascontiguousarray(points_m, dtype=np.float64))
        cloth_filter.do_filtering(ground, others, False)
    objects[np.asarray(others, dtype=np.int64)] = True
    return objects


def _one_threaded_csf() -> Any:
    """CSF with one thread: several move the cloth in an order that differs from run to run.

    Its own OpenMP reads the number of threads when it is loaded, and has no other handle.
    """
    before = os.environ.get("OMP_NUM_THREADS")
    os.environ["OMP_NUM_THREADS"] = "1"
    try:
        import CSF
    finally:
        del os.environ["OMP_NUM_THREADS"]
        if before is not None:
            os.environ["OMP_NUM_THREADS"] = before
    return CSF


@contextmanager
def _silent() -> Iterator[None]:
    """Without what compiled libraries print to the process's standard output."""
    sys.stdout.flush()
    kept = os.dup(1)
    try:
        with Path(os.devnull).open("wb") as nowhere:
            os.dup2(nowhere.fileno(), 1)
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
