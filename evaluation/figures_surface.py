"""How `surface` sees one pothole of a dense survey: the cloud, the road without it, what is left, and the outline."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator, griddata

from detector.types import DetectedObstacle, FrameDetection, PointClass
from evaluation.figure_style import colour_bar, draw_boxes, new_figure, plain, save
from evaluation.survey_detection import detect_survey
from simulator.shapes.relief import Relief
from simulator.streets.street import first_light_street

FloatArray = NDArray[np.float64]

STREET_SEED = 3
PATCH_M = 1.6
SPACING_M = 0.006
NOISE_M = 0.0015
CROSS_FALL = 0.025
GRID = 260
HEIGHTS, DEPTHS = "viridis", "RdBu_r"
# Light from the upper left, 32 degrees above the road; slopes a little flattened, so that walls do not end in black.
LIGHT = np.array([-0.6, 0.6, 0.53])
FLATTENED = 0.8


@dataclass(frozen=True, slots=True)
class Survey:
    """Points (N, 3) in metres, z up, and where they come from."""

    points_m: FloatArray
    source: str


def simulated_survey(seed: int) -> Survey:
    """The first pothole of the demo's street in 1.6 m of road with a cross fall, sampled as a depth camera would."""
    rng = np.random.default_rng(seed)
    shapes = (obstacle.shape for obstacle in first_light_street(seed=STREET_SEED).obstacles)
    relief = next(shape for shape in shapes if isinstance(shape, Relief))
    count = int((PATCH_M / SPACING_M) ** 2)
    xy = rng.uniform(-0.5 * PATCH_M, 0.5 * PATCH_M, (count, 2))
    axes = [(np.arange(n) - 0.5 * (n - 1)) * relief.step_m for n in relief.heights_m.shape]
    height = RegularGridInterpolator(axes, relief.heights_m, bounds_error=False, fill_value=0.0)(xy[:, ::-1])
    z = height + CROSS_FALL * xy[:, 1] + 0.004 * np.sin(2.0 * xy[:, 0]) + rng.normal(0.0, NOISE_M, count)
    return Survey(
        np.column_stack([xy, z]), f"a simulated pothole, cross fall {100 * CROSS_FALL:g} %, noise {1e3 * NOISE_M:g} mm"
    )


def draw_surface(path: Path, survey: Survey) -> None:
    """Four panels: the cloud in slanting light, the road's surface, the residual, the outline with the box."""
    points, detection = survey.points_m, detect_survey(survey.points_m)
    subtitle = f"{survey.source}: {len(points):,} points. {_sizes(detection.obstacles)}"
    figure = new_figure(15.6, 4.4, "Surface, residual, outline", subtitle)
    axes = [figure.add_axes((left, 0.03, 0.205, 0.74)) for left in (0.012, 0.232, 0.487, 0.742)]
    x, y, height, residual = _rasters(points, detection)
    extent = (float(x[0]), float(x[-1]), float(y[0]), float(y[-1]))
    _draw(
        axes[0],
        _shade(height, x, y),
        extent,
        "gray",
        f"the cloud, in slanting light, {extent[1] - extent[0]:.2f} m wide",
    )
    road = height - residual
    _draw_scaled(figure, axes[1], 1e3 * (road - np.nanmin(road)), extent, HEIGHTS, "the road without it", "height, mm")
    _draw_scaled(figure, axes[2], 1e3 * residual, extent, DEPTHS, "residual", "mm from the road")
    _draw(axes[3], _shade(height, x, y), extent, "gray", "points and boxes of what is found")
    inside = detection.labels == PointClass.OBSTACLE
    axes[3].scatter(points[inside, 0], points[inside, 1], s=0.5, c="#f0241a", linewidths=0, alpha=0.5, rasterized=True)
    draw_boxes(axes[3], detection.obstacles)
    axes[3].set_xlim(extent[0], extent[1])
    axes[3].set_ylim(extent[2], extent[3])
    save(figure, path)


def _rasters(points: FloatArray, detection: FrameDetection) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Axes (GRID,), and height and residual (GRID, GRID) in metres, rows y; NaN where the cloud has no points."""
    known = np.isfinite(detection.residual_m) & np.isfinite(points).all(axis=1)
    xy = points[known, :2]
    low, high = np.quantile(xy, 0.002, axis=0), np.quantile(xy, 0.998, axis=0)
    x, y = (np.linspace(low[k], high[k], GRID) for k in range(2))
    at = np.stack(np.meshgrid(x, y), axis=-1)
    values = np.column_stack([points[known, 2], detection.residual_m[known]])
    smooth = _cell_means(xy, values, low, high)
    grids = griddata(smooth[:, :2], smooth[:, 2:], at.reshape(-1, 2), method="linear").reshape(GRID, GRID, 2)
    return x, y, grids[..., 0], grids[..., 1]


def _cell_means(xy: FloatArray, values: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Mean place and values (M, 4) of the points in each cell of the picture: what a pixel shows."""
    cell = np.clip(((xy - low) / (high - low) * GRID).astype(np.int64), 0, GRID - 1)
    _, inverse, count = np.unique(cell[:, 1] * GRID + cell[:, 0], return_inverse=True, return_counts=True)
    columns = np.column_stack([xy, values])
    sums = [np.bincount(inverse, weights=columns[:, k]) for k in range(columns.shape[1])]
    return np.asarray(np.stack(sums, axis=1) / count[:, None])


def _shade(height: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    slope_y, slope_x = np.gradient(height, y[1] - y[0], x[1] - x[0])
    normal = np.stack([-FLATTENED * slope_x, -FLATTENED * slope_y, np.ones_like(height)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.asarray(normal @ (LIGHT / np.linalg.norm(LIGHT)))


def _draw(axes: Axes, image: FloatArray, extent: tuple[float, float, float, float], cmap: str, title: str) -> None:
    axes.imshow(image, extent=extent, origin="lower", cmap=cmap, interpolation="bilinear", vmin=0.0, vmax=1.0)
    plain(axes, title)


def _draw_scaled(
    figure: Figure,
    axes: Axes,
    image: FloatArray,
    extent: tuple[float, float, float, float],
    cmap: str,
    title: str,
    unit: str,
) -> None:
    low, high = float(np.nanmin(image)), float(np.nanmax(image))
    if cmap == DEPTHS:
        high = max(-low, high)
        low = -high
    axes.imshow(image, extent=extent, origin="lower", cmap=cmap, interpolation="bilinear", vmin=low, vmax=high)
    plain(axes, title)
    colour_bar(figure, axes, low, high, cmap, unit)


def _sizes(obstacles: tuple[DetectedObstacle, ...]) -> str:
    if not obstacles:
        return "Nothing found."
    one = max(obstacles, key=lambda o: o.volume_m3)
    return (
        f"Found: {one.kind.value}, {100 * one.length_m:.1f} x {100 * one.width_m:.1f} cm, {100 * one.relief_m:.1f} cm, "
        f"{1e3 * one.volume_m3:.2f} l, turned {math.degrees(one.yaw_rad):.0f}°"
    )
