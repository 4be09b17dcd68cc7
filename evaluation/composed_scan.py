"""The scenes of the paper's Table I: a scanned pothole set into a patch of road, thinned, with noise on every point."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing, binary_fill_holes, gaussian_filter

FloatArray = NDArray[np.float64]
MaskArray = NDArray[np.bool_]

VOXEL_MM = 2.0
ROAD_STEP_MM = 1.0
# Side of the patch: at 100 % of the density about 90 thousand points of road, 50 times those of a hole.
PATCH_MM = 600.0
SHRINK_BETWEEN = (1.2, 2.0)
SINK_MM = 1.0
# A hole stays this far from the edge of the patch.
EDGE_MM = 60.0
DENSITIES_PERCENT = (100, 50, 10, 5)
NOISES_MM = (0.0, 0.25, 0.5, 1.0)
# Wavelengths of macrotexture end at 50 mm (ISO 13473-1); a Gaussian of this sigma leaves those above 10 mm.
ROUGHNESS_SIGMA_MM = 5.0


class ScanError(ValueError):
    """A scan cannot be used; the message says why."""


@dataclass(frozen=True, slots=True)
class Road:
    """The patch's shape: crown as the mean cross fall from middle to edge, roughness as root mean square in mm."""

    name: str
    crown: float
    roughness_mm: float


FLAT = Road("flat road", 0.0, 0.0)
CROWNED = Road("2 % crown, 1 mm roughness", 0.02, 1.0)


@dataclass(frozen=True, slots=True)
class Scene:
    """Points (N, 3) in millimetres, z up, and which of them (N,) belong to the pothole."""

    points_mm: FloatArray
    truth: MaskArray


def read_mould(path: Path) -> FloatArray:
    """Points (N, 3) in millimetres of a PLY scan of a mould, which bulges up. Raises ScanError."""
    import open3d

    with open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error):
        points = np.asarray(open3d.io.read_point_cloud(path).points, dtype=np.float64)
    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < 100:
        raise ScanError(f"{path}: {len(points)} points were read: a PLY cloud of a pothole is expected")
    return points


def compose(mould_mm: FloatArray, road: Road, rng: np.random.Generator) -> Scene:
    """The pothole in its road, at full density and without noise.

    Flipped in z, thinned to voxels of 2 mm, divided by a number from 1.2 to 2, its top sunk 1 mm below the road and
    moved to a random place; around it a grid of step 1 mm thinned to voxels of 2 mm.
    """
    hole = voxel_means(mould_mm * np.array([1.0, 1.0, -1.0]), VOXEL_MM) / rng.uniform(*SHRINK_BETWEEN)
    hole[:, :2] -= 0.5 * (hole[:, :2].min(axis=0) + hole[:, :2].max(axis=0))
    reach = 0.5 * PATCH_MM - EDGE_MM - float(np.abs(hole[:, :2]).max())
    hole[:, :2] += rng.uniform(-1.0, 1.0, 2) * max(reach, 0.0)
    hole[:, 2] -= hole[:, 2].max() + SINK_MM
    steps = np.arange(0.0, PATCH_MM, ROAD_STEP_MM) - 0.5 * PATCH_MM
    x, y = np.meshgrid(steps, steps)
    ground = voxel_means(np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1), VOXEL_MM)
    ground = ground[~_covered(hole[:, :2], ground[:, :2])]
    points = np.concatenate([hole, ground])
    points[:, 2] += _road_height(points[:, :2], road, rng)
    return Scene(points, np.arange(len(points)) < len(hole))


def degrade(scene: Scene, density_percent: float, noise_mm: float, rng: np.random.Generator) -> Scene:
    """A random share of the points, and isotropic Gaussian noise on each that is left."""
    kept = np.flatnonzero(rng.random(len(scene.truth)) * 100.0 < density_percent)
    points = scene.points_mm[kept] + rng.normal(0.0, 1.0, (kept.size, 3)) * noise_mm
    return Scene(points, scene.truth[kept])


def voxel_means(points_mm: FloatArray, size_mm: float) -> FloatArray:
    """Mean of the points (N, 3) in each occupied voxel, (M, 3)."""
    voxel = np.floor((points_mm - points_mm.min(axis=0)) / size_mm).astype(np.int64)
    extent = voxel.max(axis=0) + 1
    key = (voxel[:, 2] * extent[1] + voxel[:, 1]) * extent[0] + voxel[:, 0]
    _, inverse, count = np.unique(key, return_inverse=True, return_counts=True)
    sums = [np.bincount(inverse, weights=points_mm[:, k]) for k in range(3)]
    return np.asarray(np.stack(sums, axis=1) / count[:, None])


def _covered(hole_xy: FloatArray, xy: FloatArray) -> MaskArray:
    """Which places (N, 2) lie over the hole: cells of the voxel's size that hold its points, closed and filled."""
    low = np.minimum(hole_xy.min(axis=0), xy.min(axis=0)) - 4.0 * VOXEL_MM
    cell = np.floor((np.concatenate([hole_xy, xy]) - low) / VOXEL_MM).astype(np.int64)
    mask = np.zeros(cell.max(axis=0) + 5, dtype=bool)
    mask[tuple(cell[: len(hole_xy)].T)] = True
    mask = binary_fill_holes(binary_closing(mask, iterations=2))
    return np.asarray(mask[tuple(cell[len(hole_xy) :].T)])


def _road_height(xy: FloatArray, road: Road, rng: np.random.Generator) -> FloatArray:
    """Height (N,) of the road: a parabola across, and a random field of Gaussian correlation."""
    half = 0.5 * PATCH_MM
    crown = -road.crown * half * np.square(xy[:, 1] / half)
    if road.roughness_mm <= 0.0:
        return crown
    side = int(PATCH_MM / ROAD_STEP_MM)
    field = gaussian_filter(rng.normal(0.0, 1.0, (side, side)), ROUGHNESS_SIGMA_MM / ROAD_STEP_MM, mode="wrap")
    field *= road.roughness_mm / field.std()
    index = np.clip(((xy + half) / ROAD_STEP_MM).astype(np.int64), 0, side - 1)
    return np.asarray(crown + field[index[:, 1], index[:, 0]])
