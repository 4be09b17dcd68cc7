"""Laser scans of real potholes' gypsum moulds, set into the road at a road pothole's size or as they were scanned."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from simulator.shapes.relief import GRID_STEP_M, Relief

SHALLOWEST_M, DEEPEST_M = 0.06, 0.12
"""Road authorities repair holes from about 4 to 5 cm on; 12 cm is the thickness of a usual asphalt layer."""

DEPTH_SHARE = 0.22
"""The moulds are half as deep as they are long, far steeper than worn holes: the depth is scaled by this share."""

MIN_POINTS = 1_000
"""Fewer points leave cells of the grid empty."""

SCAN_STEP_M = 0.001
"""Grid of a scan at its own size: the scanner left some thirty points on every square millimetre of the moulds."""

MM = 1_000.0

POINT_BYTES = 12
"""x, y, z in float32, the least that a point of a scan takes."""


class ScanError(ValueError):
    """A scan cannot be used; the message says what was expected."""


def find_scans(folder: Path) -> tuple[Path, ...]:
    """The `*.ply` files of a folder in the order of their names; `ScanError` where there are none."""
    scans = tuple(sorted(folder.glob("*.ply")))
    if not scans:
        raise ScanError(f"{folder}: no pothole scans here (expected one or more *.ply files)")
    return scans


def load_scan(path: Path, length_m: float = 0.9, depth_m: float | None = None) -> Relief:
    """Relief of a mould scan (binary PLY, millimetres, convex: z is flipped), its long axis along x.

    The plan keeps its proportions and is scaled to `length_m`; the border meets the road at 0. Without `depth_m` the
    depth follows the scan's own proportions, reduced and kept within 6 to 12 cm.
    """
    if not 0.05 <= length_m <= 10 or not (depth_m is None or 0 < depth_m <= 2):
        raise ScanError(f"a scan is set into the road 0.05 to 10 m long and up to 2 m deep, not {length_m}, {depth_m}")
    points_mm = _read_points(path)
    plan_mm = _along_principal_axes(points_mm[:, :2])
    scale = length_m / np.ptp(plan_mm[:, 0])
    depths = points_mm[:, 2] - points_mm[:, 2].min()
    if depth_m is None:
        depth_m = float(np.clip(DEPTH_SHARE * depths.max() * scale, SHALLOWEST_M, DEEPEST_M))
    mean_depth, filled = _grid_means(plan_mm * scale, depths / depths.max(), GRID_STEP_M)
    return Relief(-depth_m * mean_depth / mean_depth.max(), filled, GRID_STEP_M)


def load_scan_true(path: Path) -> Relief:
    """Relief of a mould scan at the size and the full depth it was scanned with, its long axis along x."""
    points_m = _read_points(path) / MM
    depths_m = points_m[:, 2] - points_m[:, 2].min()
    mean_depth_m, filled = _grid_means(_along_principal_axes(points_m[:, :2]), depths_m, SCAN_STEP_M)
    return Relief(-mean_depth_m, filled, SCAN_STEP_M)


def write_mould(path: Path, relief: Relief) -> None:
    """Write a hole as its mould would be scanned, the form that `load_scan` reads; `ValueError` if it is no hole.

    Binary PLY of float32 x, y, z in millimetres: the footprint's grid points, z the depth below the road, so convex.
    """
    if not relief.is_hole:
        raise ValueError("only a hole has a mould")
    rows, columns = np.nonzero(relief.footprint)
    middle = (np.array(relief.footprint.shape) - 1) / 2
    plan_m = (np.stack([columns, rows], axis=1) - middle[::-1]) * relief.step_m
    depth_m = np.maximum(-relief.solid_m[rows, columns], 0)
    points = np.column_stack([plan_m, depth_m]) * MM
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    header += "property float x\nproperty float y\nproperty float z\nend_header\n"
    path.write_bytes(header.encode() + points.astype("<f4").tobytes())


def _read_points(path: Path) -> NDArray[np.float64]:
    import open3d as o3d  # heavy: only those who load a scan wait for it

    _check_length(path)
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        points = np.asarray(o3d.io.read_point_cloud(path).points, dtype=np.float64)
    if len(points) < MIN_POINTS or not np.isfinite(points).all() or not np.ptp(points, axis=0).all():
        raise ScanError(f"{path}: expected at least {MIN_POINTS} finite points of a surface with depth")
    return points


def _check_length(path: Path) -> None:
    """Refuse what is not a PLY file as long as its header announces: Open3D would fill what is missing with zeros."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ScanError(f"{path}: cannot be read: {error.strerror}") from error
    header, _, body = data.partition(b"end_header\n")
    lines = [line.split() for line in header.decode("ascii", "replace").splitlines()]
    counts = [line[2] for line in lines if line[:2] == ["element", "vertex"] and len(line) == 3]
    if ["format", "binary_little_endian", "1.0"] not in lines or not counts or not counts[0].isdigit():
        raise ScanError(f"{path}: expected a binary PLY file whose header says 'element vertex N'")
    if len(body) < int(counts[0]) * POINT_BYTES:
        raise ScanError(f"{path}: the header announces {counts[0]} points, the file ends before them")


def _along_principal_axes(plan: NDArray[np.float64]) -> NDArray[np.float64]:
    """Plan positions about the middle of their box, turned so that the direction of greatest spread is x."""
    _, vectors = np.linalg.eigh(np.cov(plan.T))
    turned = plan @ vectors[:, ::-1]
    return np.asarray(turned - (turned.min(axis=0) + turned.max(axis=0)) / 2)


def _grid_means(
    plan_m: NDArray[np.float64], depths: NDArray[np.float64], step_m: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Mean depth of the points of each cell (empty cells inside take their nearest neighbour's) and the filled cells.

    One undisturbed cell is left all round, so that the border meets the road.
    """
    half = np.ceil(np.abs(plan_m).max(axis=0) / step_m).astype(int) + 1
    columns, rows = (np.rint(plan_m / step_m).astype(int) + half).T
    shape = (2 * half[1] + 1, 2 * half[0] + 1)
    counts, sums = np.zeros(shape), np.zeros(shape)
    np.add.at(counts, (rows, columns), 1)
    np.add.at(sums, (rows, columns), depths)
    filled = ndimage.binary_fill_holes(counts > 0)
    nearest = ndimage.distance_transform_edt(counts == 0, return_distances=False, return_indices=True)
    means = (sums / np.maximum(counts, 1))[tuple(nearest)]
    return np.where(filled, means, 0.0), filled
