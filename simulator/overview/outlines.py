"""Footprints of obstacles, in the street and side by side."""

from __future__ import annotations

import math

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from contract.geometry import Kind
from simulator.changes import GROWN, Change
from simulator.overview.style import INK, KIND_COLOURS, headline, note, without_frame
from simulator.scenario import Scenario
from simulator.streets.street import PlacedObstacle

FloatArray = NDArray[np.float64]

LATTICE = 160
"""Cells along an outline's longer side: finer than a picture of this size shows."""

ROW_M, LONGEST_M, GAP_M = 21.0, 2.0, 0.35
WORDS_M, CHANGED_WORDS_M = 0.85, 1.4
"""How much outline fits in a row; what is longer is drawn at half the scale; words need so much room."""


def outlines(placed: PlacedObstacle) -> list[FloatArray]:
    """Outer edges (N, 2) of the footprint, frame `street`."""
    cos, sin = math.cos(placed.yaw_rad), math.sin(placed.yaw_rad)
    turn = np.array([[cos, sin], [-sin, cos]])
    return [outline @ turn + (placed.x_m, placed.y_m) for outline in _local_outlines(placed)]


def draw_outlines(axes: Axes, happening: Scenario) -> None:
    """Footprints side by side at one scale, what changes first; dashed where they grow."""
    changes = {change.obstacle_id: change for change in happening.changing.changes}
    obstacles = sorted(happening.changing.street.obstacles, key=lambda o: (o.obstacle_id not in changes, o.obstacle_id))
    x_m, shown, half_height_m = 0.0, 0, 0.6
    for placed in obstacles:
        scale = 0.5 if max(placed.shape.length_m, placed.shape.width_m) > LONGEST_M else 1.0
        words_m = CHANGED_WORDS_M if placed.obstacle_id in changes else WORDS_M
        length_m = max(scale * placed.shape.length_m, words_m)
        if x_m + length_m > ROW_M:
            break
        middle = x_m + length_m / 2
        _draw_outline(axes, placed, changes.get(placed.obstacle_id), middle, scale)
        half_height_m = max(half_height_m, scale * placed.shape.width_m / 2)
        x_m, shown = x_m + length_m + GAP_M, shown + 1
    axes.plot([0, 1], [-half_height_m - 0.12] * 2, color=INK, linewidth=2)
    axes.text(1.1, -half_height_m - 0.12, "1 m", va="center", fontsize=8)
    axes.set(xlim=(-0.2, max(x_m, ROW_M * 0.6)), ylim=(-half_height_m - 0.25, half_height_m + 0.75), aspect="equal")
    axes.set_anchor("W")
    more = f" ({len(obstacles) - shown} more are in obstacles.json)" if shown < len(obstacles) else ""
    headline(axes, f"Obstacles in true outline{more}")
    without_frame(axes)


def _draw_outline(axes: Axes, placed: PlacedObstacle, change: Change | None, at_m: float, scale: float) -> None:
    colour, shape = KIND_COLOURS[placed.kind], placed.shape
    for outline in _local_outlines(placed):
        axes.add_artist(
            Polygon(scale * outline + (at_m, 0), facecolor=colour, edgecolor=colour, alpha=0.3, linewidth=0)
        )
        axes.add_artist(Polygon(scale * outline + (at_m, 0), fill=False, edgecolor=colour, linewidth=1.2))
        if change is not None and change.what == GROWN:
            grown = scale * math.sqrt(change.area_factor) * outline + (at_m, 0)
            axes.add_artist(Polygon(grown, fill=False, edgecolor=colour, linewidth=1.0, linestyle="--"))
    top = scale * shape.width_m / 2 * (math.sqrt(change.area_factor) if change else 1.0)
    sign = "-" if placed.kind is Kind.POTHOLE else "+"
    facts = f"{placed.obstacle_id}{' (1:2)' if scale < 1 else ''}\n{sign}{100 * shape.relief_m:.0f} cm"
    if change is not None:
        facts += f"\n{change.what} {change.time_s:.1f} s"
    where = np.array([at_m, top])
    note(axes, facts, where, (0, 3), colour, va="bottom", fontsize=7.5, linespacing=1.1, annotation_clip=False)


def _local_outlines(placed: PlacedObstacle) -> list[FloatArray]:
    """Outer edges (N, 2) of the footprint about its centre."""
    shape = placed.shape
    cell_m = max(shape.length_m, shape.width_m) / LATTICE
    half = 0.55 * np.array([shape.length_m, shape.width_m]) + 2 * cell_m
    x, y = (np.arange(-h, h + cell_m, cell_m) for h in half)
    inside = shape.covers(*(axis.ravel() for axis in np.meshgrid(x, y))).reshape(len(y), len(x))
    found, _ = cv2.findContours(inside.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return [np.stack([x[one[:, 0, 0]], y[one[:, 0, 1]]], axis=1) for one in found if len(one) > 2]
