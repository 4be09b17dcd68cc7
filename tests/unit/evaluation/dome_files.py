"""Files of the kinds that the tables read, small and made up."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import open3d


def write_dome(path: Path, seed: int = 0, count: int = 40_000) -> None:
    """A scan of a mould in millimetres: a dome of 80 mm across and 30 mm height, as PLY."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-40.0, 40.0, (count, 2))
    square = 1.0 - np.square(xy / 40.0).sum(axis=1)
    xy, square = xy[square > 0.0], square[square > 0.0]
    write_ply(path, np.column_stack([xy, 30.0 * np.sqrt(square)]))


def write_ply(path: Path, points: np.ndarray) -> None:
    """Points (N, 3) as PLY."""
    path.parent.mkdir(parents=True, exist_ok=True)
    open3d.io.write_point_cloud(str(path), open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points)))


def stereo_frame(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Transformed disparity (240, 320) with a hole and its label: a wall of 3 px, hidden on one side."""
    rng = np.random.default_rng(seed)
    row, column = np.mgrid[:240, :320]
    reach = np.hypot((column - 160) / 45.0, (row - 120) / 30.0)
    disparity = 50_000.0 + rng.normal(0.0, 150.0, reach.shape) + 20.0 * column
    disparity -= 22_000.0 * np.clip((1.0 - reach) / 0.08, 0.0, 1.0)
    label = reach < 0.96
    disparity[label & (row > 138)] = 0.0
    disparity[::60, 5] = 3_000.0
    return disparity.astype(np.uint16), label


def write_stereo(folder: Path, dataset: str = "dataset1", number: str = "01", seed: int = 0) -> None:
    """A frame and its label as PNG files."""
    disparity, label = stereo_frame(seed)
    (folder / dataset).mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(folder / dataset / f"{number}_disparity.png"), disparity)
    cv2.imwrite(str(folder / dataset / f"{number}_label.png"), label.astype(np.uint8) * 255)
