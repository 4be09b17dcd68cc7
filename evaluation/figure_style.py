"""What the figures share: the paper's colours on white, panels seen from above and from behind the sensor."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from detector.types import DetectedObstacle, PointClass

FloatArray = NDArray[np.float64]
Colours = NDArray[np.float64] | NDArray[np.float32] | list[str]

CLASS_COLOURS = {
    PointClass.UNCLASSIFIED: "#c3c9d4",
    PointClass.SAFE_ROAD: "#2f6bff",
    PointClass.NEGATIVE: "#f2c200",
    PointClass.POSITIVE: "#12c7d6",
    PointClass.OUTSIDE: "#a64dff",
    PointClass.OBSTACLE: "#f0241a",
}
CLASS_MEANINGS = {
    PointClass.SAFE_ROAD: "safe road",
    PointClass.NEGATIVE: "be aware: below the road",
    PointClass.POSITIVE: "hazardous: above the road",
    PointClass.OUTSIDE: "dangerous: beside the road",
    PointClass.OBSTACLE: "recognised obstacle",
    PointClass.UNCLASSIFIED: "flat ground, unclassified",
}
INK, SOFT = "#1b2330", "#7b8698"
HEAT = "turbo"
DPI = 130
# A camera above and behind the sensor, looking a little down.
EYE_BEHIND_M, EYE_ABOVE_M, LOOK_DOWN_RAD, FOV_RAD = 4.0, 2.0, math.radians(12.0), math.radians(62.0)


def new_figure(width_in: float, height_in: float, title: str, subtitle: str) -> Figure:
    """A white figure with its title at the upper left."""
    figure = Figure(figsize=(width_in, height_in), dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    figure.text(0.02, 1.0 - 0.22 / height_in, title, fontsize=15, fontweight="bold", color=INK, va="top")
    figure.text(0.02, 1.0 - 0.55 / height_in, subtitle, fontsize=9.5, color=SOFT, va="top")
    return figure


def save(figure: Figure, path: Path) -> None:
    """Write a PNG; the same figure gives the same bytes."""
    figure.savefig(path, facecolor="white", metadata={"Software": None})


def plain(axes: Axes, title: str = "") -> None:
    """Only a picture: no ticks, a thin frame, the title above."""
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_color("#d9dee7")
    if title:
        axes.set_title(title, fontsize=10.5, color=INK, pad=6)


def from_above(axes: Axes, points: FloatArray, colours: Colours, size: float) -> None:
    """Points (N, 2) with colours (N,), equal scales."""
    axes.scatter(points[:, 0], points[:, 1], s=size, c=colours, linewidths=0, rasterized=True)
    axes.set_aspect("equal")


def from_behind(axes: Axes, points_m: FloatArray, colours: Colours) -> None:
    """Points (N, 3) of the `sensor` frame as a camera behind and above the sensor sees them; near ones are larger."""
    c, s = math.cos(LOOK_DOWN_RAD), math.sin(LOOK_DOWN_RAD)
    x, y, z = points_m[:, 0] + EYE_BEHIND_M, points_m[:, 1], points_m[:, 2] - EYE_ABOVE_M
    depth, up = c * x - s * z, s * x + c * z
    seen = np.flatnonzero(depth > 1.0)
    seen = seen[np.argsort(-depth[seen], kind="stable")]
    u, v = -y[seen] / depth[seen], up[seen] / depth[seen]
    axes.scatter(
        u, v, s=np.clip(22.0 / depth[seen], 0.3, 4.0), c=np.asarray(colours)[seen], linewidths=0, rasterized=True
    )
    half = math.tan(0.5 * FOV_RAD)
    axes.set_xlim(-half, half)
    axes.set_ylim(-0.36, 0.20)
    axes.set_aspect("equal")


def draw_boxes(axes: Axes, obstacles: tuple[DetectedObstacle, ...]) -> None:
    """Oriented boxes from above; those of rises are broken."""
    for obstacle in obstacles:
        u = np.array([math.cos(obstacle.yaw_rad), math.sin(obstacle.yaw_rad)]) * obstacle.length_m / 2.0
        v = np.array([-math.sin(obstacle.yaw_rad), math.cos(obstacle.yaw_rad)]) * obstacle.width_m / 2.0
        corners = obstacle.centre_m[:2] + np.array([u + v, u - v, -u - v, v - u, u + v])
        style = "-" if obstacle.kind.is_negative else (0, (2.0, 1.5))
        axes.plot(corners[:, 0], corners[:, 1], color=INK, lw=1.3, ls=style)


def class_colours(labels: NDArray[np.uint8]) -> list[str]:
    """Colour of each of the labels (N,)."""
    return [CLASS_COLOURS[PointClass(label)] for label in labels]


def class_legend(figure: Figure, y: float) -> None:
    """The classes in a row below."""
    handles = [
        Line2D([], [], marker="o", ls="", ms=7, color=CLASS_COLOURS[kind], label=meaning)
        for kind, meaning in CLASS_MEANINGS.items()
    ]
    figure.legend(handles=handles, loc="lower center", ncols=6, fontsize=9, frameon=False, bbox_to_anchor=(0.5, y))


def colour_bar(figure: Figure, axes: Axes, low: float, high: float, cmap: str, label: str) -> None:
    """A thin bar at the right of a panel."""
    beside = axes.inset_axes((1.02, 0.0, 0.035, 1.0))
    bar = figure.colorbar(ScalarMappable(Normalize(low, high), cmap), cax=beside)
    bar.set_label(label, fontsize=9, color=INK)
    bar.ax.tick_params(labelsize=8, color=SOFT)
    bar.outline.set_visible(False)
