"""The picture of one sweep: from above and from behind the sensor, in the paper's five colours, obstacles boxed."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from detector.types import DetectedObstacle, FrameDetection, PointClass

FloatArray = NDArray[np.float64]

COLOURS = {
    PointClass.UNCLASSIFIED: "#596273",
    PointClass.SAFE_ROAD: "#3f7cff",
    PointClass.NEGATIVE: "#ffd60a",
    PointClass.POSITIVE: "#20e3e3",
    PointClass.OUTSIDE: "#b455ff",
    PointClass.OBSTACLE: "#ff3b30",
}
MEANINGS = {
    PointClass.SAFE_ROAD: "safe road",
    PointClass.NEGATIVE: "below the road",
    PointClass.POSITIVE: "above the road",
    PointClass.OUTSIDE: "beside the road",
    PointClass.OBSTACLE: "recognised obstacle",
    PointClass.UNCLASSIFIED: "unclassified",
}
BACKGROUND, INK, LINES = "#0b0e14", "#e8ecf4", "#2a3140"

AHEAD_M, BEHIND_M, BESIDE_M = 42.0, 12.0, 18.0
LISTED = 5
EYE_BEHIND_M, EYE_ABOVE_M, LOOK_DOWN_RAD, FOV_RAD = 5.0, 3.2, math.radians(13.0), math.radians(64.0)


def draw_detection(
    path: Path, points_m: NDArray[np.float32], detection: FrameDetection, sensor_height_m: float, title: str
) -> None:
    """Write a PNG of a sweep (N, 3), frame `sensor`, and of what was found in it."""
    finite = np.isfinite(points_m).all(axis=1)
    points, labels = points_m[finite].astype(np.float64), detection.labels[finite]
    figure = Figure(figsize=(16, 9), dpi=110, facecolor=BACKGROUND)
    FigureCanvasAgg(figure)
    above = figure.add_axes((0.045, 0.07, 0.315, 0.82))
    forward = figure.add_axes((0.385, 0.20, 0.60, 0.69))
    _draw_from_above(above, points, labels, detection.obstacles)
    _draw_forward(forward, points, labels, detection.obstacles, sensor_height_m)
    figure.text(0.045, 0.935, title, color=INK, fontsize=19, fontweight="bold")
    summary = f"{len(points_m):,} points · sensor {sensor_height_m:.2f} m above the road · {_found(detection)}"
    figure.text(0.985, 0.935, summary, color=INK, fontsize=12, ha="right")
    _draw_legend(figure, labels)
    _list_obstacles(figure, detection.obstacles)
    figure.savefig(path, facecolor=BACKGROUND)


def _found(detection: FrameDetection) -> str:
    if not detection.road_seen:
        return "no road in view"
    count = len(detection.obstacles)
    return "no obstacle" if count == 0 else f"{count} obstacle{'s' if count > 1 else ''}"


def _draw_from_above(
    axes: Axes, points: FloatArray, labels: NDArray[np.uint8], obstacles: tuple[DetectedObstacle, ...]
) -> None:
    _prepare(axes)
    for label in _drawing_order(labels):
        chosen = points[labels == label]
        size = 9.0 if label == PointClass.OBSTACLE else 1.1
        axes.scatter(-chosen[:, 1], chosen[:, 0], s=size, c=COLOURS[label], linewidths=0, rasterized=True)
    angle = np.linspace(0, 2 * np.pi, 200)
    for radius in (10, 20, 30, 40):
        axes.plot(radius * np.sin(angle), radius * np.cos(angle), color=LINES, lw=0.8, zorder=0)
        axes.text(0.4, radius + 0.3, f"{radius} m", color="#8a94a8", fontsize=8)
    axes.plot([-0.9, 0.9, 0.9, -0.9, -0.9], [-2.2, -2.2, 2.0, 2.0, -2.2], color=INK, lw=1.3)
    for number, obstacle in enumerate(obstacles, start=1):
        outline = _box_corners(obstacle)[[0, 1, 2, 3, 0]]
        axes.plot(-outline[:, 1], outline[:, 0], color=INK, lw=1.4)
        at = (-float(obstacle.centre_m[1]), float(obstacle.centre_m[0]))
        axes.annotate(str(number), at, (9, 9), textcoords="offset points", color=INK, fontsize=11, fontweight="bold")
    axes.set(xlim=(-BESIDE_M, BESIDE_M), ylim=(-BEHIND_M, AHEAD_M), aspect="equal")
    axes.set_title("from above", color="#8a94a8", fontsize=11, loc="left")


def _draw_forward(
    axes: Axes,
    points: FloatArray,
    labels: NDArray[np.uint8],
    obstacles: tuple[DetectedObstacle, ...],
    sensor_height_m: float,
) -> None:
    """Points and boxes as a camera behind and above the sensor would see them; near points are larger."""
    _prepare(axes)
    eye = np.array([-EYE_BEHIND_M, 0.0, max(EYE_ABOVE_M, sensor_height_m + 1.0) - sensor_height_m])
    seen, distance = _projected(points, eye)
    visible = (distance > 1.0) & (distance < 90.0) & (np.abs(seen) < 1.2).all(axis=1)
    for label in _drawing_order(labels):
        chosen = visible & (labels == label)
        size = np.clip((260.0 if label == PointClass.OBSTACLE else 130.0) / distance[chosen] ** 1.5, 0.5, 26)
        axes.scatter(seen[chosen, 0], seen[chosen, 1], s=size, c=COLOURS[label], linewidths=0, rasterized=True)
    for number, obstacle in enumerate(obstacles, start=1):
        corners, distances = _projected(_box_corners(obstacle), eye)
        if distances.min() < 1.0:
            continue
        for edge in ((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)):
            axes.plot(*corners[list(edge)].T, color=INK, lw=1.2)
        top = corners[corners[:, 1].argmax()]
        name = f"{number} {obstacle.kind.value}"
        axes.annotate(name, top, (0, 8), textcoords="offset points", color=INK, fontsize=10, ha="center", clip_on=True)
    half = math.tan(FOV_RAD / 2)
    axes.set(xlim=(-half, half), ylim=(-0.52 * half, 0.42 * half), xticks=[], yticks=[])
    axes.set_title("ahead", color="#8a94a8", fontsize=11, loc="left")


def _projected(points: FloatArray, eye: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Image plane positions (N, 2), right and up at unit distance, and distances along the view (N,)."""
    offset = points - eye
    sin, cos = math.sin(LOOK_DOWN_RAD), math.cos(LOOK_DOWN_RAD)
    forward, up = cos * offset[:, 0] - sin * offset[:, 2], sin * offset[:, 0] + cos * offset[:, 2]
    safe = np.where(forward > 0.1, forward, np.inf)
    return np.stack([-offset[:, 1] / safe, up / safe], axis=1), forward


def _box_corners(obstacle: DetectedObstacle) -> FloatArray:
    """Corners (8, 3) of an obstacle's box: four at one level, then four at the other."""
    cos, sin = math.cos(obstacle.yaw_rad), math.sin(obstacle.yaw_rad)
    u, v = obstacle.length_m / 2, obstacle.width_m / 2
    plan = np.array([[u, v], [-u, v], [-u, -v], [u, -v]]) @ np.array([[cos, sin], [-sin, cos]])
    levels = (0.0, -obstacle.relief_m if obstacle.kind.is_negative else obstacle.relief_m)
    return np.concatenate([np.column_stack([plan, np.full(4, level)]) for level in levels]) + obstacle.centre_m


def _drawing_order(labels: NDArray[np.uint8]) -> list[PointClass]:
    """The classes that occur, those that matter most last, so that nothing covers them."""
    return [label for label in PointClass if (labels == label).any()]


def _prepare(axes: Axes) -> None:
    axes.set_facecolor(BACKGROUND)
    axes.tick_params(colors="#8a94a8", labelsize=8)
    for spine in axes.spines.values():
        spine.set_color(LINES)


def _draw_legend(figure: Figure, labels: NDArray[np.uint8]) -> None:
    entries = [
        Line2D(
            [],
            [],
            marker="o",
            ls="",
            ms=8,
            mec="none",
            mfc=COLOURS[label],
            label=f"{meaning}  {(labels == label).sum():,}",
        )
        for label, meaning in MEANINGS.items()
    ]
    legend = figure.legend(handles=entries, loc="lower left", bbox_to_anchor=(0.38, 0.02), ncols=2, frameon=False)
    for text in legend.get_texts():
        text.set_color(INK)


def _list_obstacles(figure: Figure, obstacles: tuple[DetectedObstacle, ...]) -> None:
    """The first obstacles in words."""
    for line, obstacle in enumerate(obstacles[:LISTED]):
        relief = "deep" if obstacle.kind.is_negative else "high"
        size = f"{obstacle.length_m:.2f} x {obstacle.width_m:.2f} m, {100 * obstacle.relief_m:.0f} cm {relief}"
        distance_m = math.hypot(*obstacle.centre_m[:2])
        text = f"{line + 1}  {obstacle.kind.value} at {distance_m:.1f} m: {size}, confidence {obstacle.confidence:.2f}"
        figure.text(0.68, 0.145 - 0.028 * line, text, color=INK, fontsize=10)
