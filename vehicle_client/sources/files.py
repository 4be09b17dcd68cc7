"""One sweep from one file, in the formats that LiDAR scans are kept in: a small reader each, input order kept."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vehicle_client.sources.cloud_header import check_announced_points, check_las_header
from vehicle_client.sources.frame import LidarFrame, SourceError
from vehicle_client.sources.point_fields import sweep_of
from vehicle_client.sources.record_clouds import read_records

Float32Array = NDArray[np.float32]

POINTS_TO_TRY = 4_096
"""By so many points a scan is told from one of another layout."""

LIDAR_REACH_M = 1_000.0
"""No vehicle's LiDAR sees farther: larger coordinates are map coordinates, another unit or noise."""


def read_cloud(path: Path) -> LidarFrame:
    """The sweep in a file, by its ending: `.bin` (KITTI), `.pcd.bin` (nuScenes), PLY, PCD, LAS, LAZ, NPY or NPZ.

    Points that are not finite are kept, so that results stay in the input's order. The stamp is 0: a single cloud
    carries no time. `SourceError` says what was expected of a file that cannot be read.
    """
    ending = next((e for e in READERS if path.name.lower().endswith(e)), None)
    if ending is None:
        raise SourceError(f"{path}: unknown kind of file; expected one of {', '.join(sorted(READERS))}")
    if not path.is_file():
        raise SourceError(f"{path}: no such file")
    try:
        frame = READERS[ending](path)
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error}") from error
    _check_extent(path, frame.points_m)
    return frame


def read_kitti(path: Path) -> LidarFrame:
    """Float32 x, y, z, reflectance; x forward, y left. A nuScenes scan of that name is told by its rings."""
    if _has_rings(path):
        return read_nuscenes(path)
    values = _float32_rows(path, 4, "KITTI scan (x, y, z, reflectance)")
    return LidarFrame(0.0, values[:, :3].copy(), intensity=values[:, 3].copy())


def read_nuscenes(path: Path) -> LidarFrame:
    """Float32 x, y, z, intensity, ring; x right, y forward, turned here to x forward, y left."""
    values = _float32_rows(path, 5, "nuScenes scan (x, y, z, intensity, ring)")
    points = np.stack([values[:, 1], -values[:, 0], values[:, 2]], axis=1)
    ring = values[:, 4]
    if not _are_rings(ring):
        raise SourceError(f"{path}: expected a nuScenes scan whose fifth value is the ring, a whole number")
    return LidarFrame(0.0, points, intensity=values[:, 3].copy(), ring=ring.astype(np.uint16))


def read_ply_or_pcd(path: Path) -> LidarFrame:
    """PLY or PCD, as many points as the header announces; binary ones with intensity, ring and times."""
    expected = check_announced_points(path)
    try:
        records = read_records(path, expected) if expected else None
        return read_open3d(path, expected) if records is None else sweep_of(0.0, records)
    except SourceError as error:
        raise SourceError(str(error) if str(path) in str(error) else f"{path}: {error}") from error


def read_open3d(path: Path, expected: int) -> LidarFrame:
    """Text and compressed ones, points alone: where a file ends early Open3D only prints a warning."""
    import open3d as o3d  # heavy: only those who read these formats wait for it

    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        points = np.asarray(o3d.io.read_point_cloud(path).points)
    if len(points) != expected:
        raise SourceError(f"{path}: the header announces {expected} points, {len(points)} could be read")
    return LidarFrame(0.0, _float32(points))


def read_las(path: Path) -> LidarFrame:
    """LAS or LAZ in the sensor frame, with intensity."""
    import laspy

    expected = check_las_header(path)
    try:
        # In one thread: it takes hardly longer, and whoever drives along such files needs the other core.
        cloud = laspy.read(path, laz_backend=laspy.LazBackend.Lazrs)
        points = np.empty((len(cloud.points), 3), dtype=np.float32)
        for axis, name in enumerate("xyz"):
            points[:, axis] = _float32(np.asarray(cloud[name]))
        intensity = np.asarray(cloud.intensity, dtype=np.float32)
    except Exception as error:  # laspy's parsers raise a dozen types where bytes make no sense
        raise SourceError(f"{path}: expected a whole LAS or LAZ file: {error}") from error
    if len(points) != expected:
        raise SourceError(f"{path}: the header announces {expected} points, {len(points)} are there")
    return LidarFrame(0.0, points, intensity=intensity)


def read_numpy(path: Path) -> LidarFrame:
    """NPY, or NPZ with an array `points` (or only one array): (N, 3) x, y, z, or (N, 4) with intensity."""
    try:
        loaded = np.load(path, allow_pickle=False)
        values = loaded if isinstance(loaded, np.ndarray) else _points_of(loaded)
    except Exception as error:  # so do NumPy's and zipfile's
        raise SourceError(
            f"{path}: expected a NumPy file with an array of numbers (N, 3), in NPZ one array or one called points"
        ) from error
    if values.ndim != 2 or values.shape[1] < 3 or values.dtype.kind not in "fiu":
        raise SourceError(f"{path}: expected an array of numbers (N, 3) or (N, 4), found {values.dtype} {values.shape}")
    return LidarFrame(
        0.0, _float32(values[:, :3]), intensity=values[:, 3].astype(np.float32) if values.shape[1] == 4 else None
    )


READERS: dict[str, Callable[[Path], LidarFrame]] = {
    ".pcd.bin": read_nuscenes,  # before .bin: the longer ending wins
    ".bin": read_kitti,
    ".ply": read_ply_or_pcd,
    ".pcd": read_ply_or_pcd,
    ".las": read_las,
    ".laz": read_las,
    ".npy": read_numpy,
    ".npz": read_numpy,
}


def _float32_rows(path: Path, columns: int, what: str) -> Float32Array:
    data = path.read_bytes()
    if len(data) % (4 * columns):
        raise SourceError(f"{path}: {len(data)} bytes are not whole points of a {what}, {4 * columns} bytes each")
    return np.frombuffer(data, dtype="<f4").reshape(-1, columns)


def _has_rings(path: Path) -> bool:
    """Whether a file of float32 has points of five values, of which the last is a ring: reflectances are none."""
    if path.stat().st_size % 20:
        return False
    with path.open("rb") as file:
        start = file.read(20 * POINTS_TO_TRY)
    return len(start) > 0 and _are_rings(np.frombuffer(start, dtype="<f4").reshape(-1, 5)[:, 4])


def _are_rings(values: Float32Array) -> bool:
    """Whether all are whole numbers of rings."""
    numbers = np.nan_to_num(values, nan=-1.0, posinf=-1.0, neginf=-1.0)
    return bool(((numbers >= 0) & (numbers < 1024) & (numbers % 1 == 0)).all())


def _points_of(archive: np.lib.npyio.NpzFile) -> NDArray[np.generic]:
    with archive:
        name = archive.files[0] if len(archive.files) == 1 else "points"
        return np.asarray(archive[name])


def _float32(points: NDArray[np.generic]) -> Float32Array:
    """Points in float32; what does not fit becomes infinite and counts as a point that was not measured."""
    with np.errstate(over="ignore"):
        return points.astype(np.float32)


def _check_extent(path: Path, points_m: Float32Array) -> None:
    """Refuse clouds without points, and those that cannot be a sweep in metres about its sensor."""
    if not len(points_m):
        raise SourceError(f"{path}: holds no points")
    # By columns: over rows of three NumPy takes ten times as long.
    x, y, z = (np.isfinite(column) for column in points_m.T)
    finite = x & y & z
    if not finite.any():
        raise SourceError(f"{path}: none of its {len(points_m)} points is finite")
    x, y, z = (np.abs(column) > LIDAR_REACH_M for column in points_m.T)
    if 2 * np.count_nonzero(finite & (x | y | z)) > np.count_nonzero(finite):
        raise SourceError(f"{path}: expected metres in the sensor's frame, but most points are beyond 1 km")
