"""The report's drawings: the street with what each car knew when, and two cars' clouds laid on each other."""

from __future__ import annotations

import io
from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, Polygon, Rectangle

from contract.obstacle import ObstacleCollection, ObstacleFeature
from headsup.demo.record import DriveRecord, true_name
from simulator.streets.street import PlacedObstacle, Street
from vehicle_client.frames import apply, inverse, rotation_about_z

mpl.use("Agg")

INK, MUTED, ROAD, KERB = "#1f2933", "#7b8794", "#d9dde2", "#b4bac2"
OBSTACLE_COLOURS = ("#d64545", "#2f80c0", "#8a5cc2", "#d98e04")
CLOUD_COLOURS = ("#2f80c0", "#e4572e")
CAR_LENGTH_M, CAR_WIDTH_M = 4.3, 1.8


def street_plan(street: Street, records: Sequence[DriveRecord], obstacles: ObstacleCollection) -> str:
    """SVG: the street from above over a strip a car that shows from where on it knew of each obstacle, and how."""
    figure = Figure(figsize=(12, 6.4), layout="constrained")
    plan, knowledge = figure.subplots(2, 1, sharex=True, height_ratios=(1, 2.4))
    _draw_street(plan, street, obstacles)
    _draw_knowledge(knowledge, street, records)
    return _svg(figure)


def clouds(street: Street, first: DriveRecord, second: DriveRecord) -> str:
    """SVG: what lies off the road in two cars' clouds, as satellites place them and after the shift of the matches."""
    figure = Figure(figsize=(12, 4.4), layout="constrained")
    middle = street.obstacles[0]
    shifts = (np.zeros(2), second.alignment.shift_m)
    titles = ("Each where its own satellites put it", "ego1's shifted by the obstacles that both saw")
    for axes, shift, title in zip(figure.subplots(1, 2, sharey=True), shifts, titles, strict=True):
        # The shift lays the server's map, ego1's cloud here, on what the second car sees.
        for record, colour, moved in ((first, CLOUD_COLOURS[0], shift), (second, CLOUD_COLOURS[1], np.zeros(2))):
            points = np.concatenate(record.clouds)
            x, y = points[:, 0] + moved[0], points[:, 1] + moved[1]
            # As a bitmap: as vectors some ten thousand points take 20 MB.
            axes.scatter(x, y, s=1.2, c=colour, label=record.car, lw=0, rasterized=True)
        axes.set(xlim=(middle.x_m - 9, middle.x_m + 9), ylim=(-6.5, 4.2), aspect="equal")
        axes.set_title(title, loc="left", fontsize=10, color=INK)
        axes.set_xlabel("along the street, m", color=INK)
        axes.legend(loc="upper right", markerscale=6, frameon=False)
    return _svg(figure)


def _draw_street(axes: Axes, street: Street, obstacles: ObstacleCollection) -> None:
    half = street.main.section.half_width_m
    outer = half + street.main.section.pavement_width_m
    axes.add_patch(Rectangle((0, -outer), street.length_m, 2 * outer, color="#eef0f2"))
    axes.add_patch(Rectangle((0, -half), street.length_m, 2 * half, color=ROAD))
    axes.plot([0, street.length_m], [0, 0], color="white", lw=1.2, dashes=(8, 6))
    for car in street.parked_cars:
        axes.add_patch(
            Rectangle((car.x_m - CAR_LENGTH_M / 2, car.y_m - CAR_WIDTH_M / 2), CAR_LENGTH_M, CAR_WIDTH_M, color=KERB)
        )
    for placed, colour in zip(street.obstacles, OBSTACLE_COLOURS, strict=False):
        axes.add_patch(Polygon(_outline(placed), closed=True, color=colour, lw=1.5))
        axes.annotate(
            true_name(street, placed.obstacle_id),
            (placed.x_m, half + 0.3),
            ha="center",
            fontsize=8,
            color=colour,
        )
    for feature in obstacles.features:
        _draw_stored(axes, street, feature)
    axes.set(ylim=(-half - 1.5, half + 2), yticks=[], aspect="auto")
    axes.set_title(
        "The street with true outlines; rings: where the server believes what is left (1 sigma)",
        loc="left",
        fontsize=10,
        color=INK,
    )
    axes.spines[:].set_visible(False)


def _outline(placed: PlacedObstacle) -> np.ndarray:
    half = np.array([placed.shape.length_m, placed.shape.width_m]) / 2
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half
    turned: np.ndarray = corners @ rotation_about_z(placed.yaw_rad)[:2, :2].T + (placed.x_m, placed.y_m)
    return turned


def _draw_stored(axes: Axes, street: Street, feature: ObstacleFeature) -> None:
    georeference = street.georeference
    enu = georeference.enu_from_geodetic(feature.position, georeference.altitude_m)
    x, y, _ = apply(inverse(street.enu_from_street), enu)
    covariance = feature.properties.position_covariance
    sd_m = float(np.sqrt((covariance.east_m2 + covariance.north_m2) / 2))
    axes.add_patch(Ellipse((x, y), 2 * sd_m, 2 * sd_m, fill=False, color=INK, lw=1))


def _draw_knowledge(axes: Axes, street: Street, records: Sequence[DriveRecord]) -> None:
    count = len(street.obstacles)
    for row, record in enumerate(records):
        base = -row
        axes.axhline(base - 0.5, color="#eef0f2", lw=1)
        start = record.travelled_x_m[0]
        axes.annotate(record.car, (-2, base), ha="right", va="center", fontsize=10, color=INK, annotation_clip=False)
        for index, placed in enumerate(street.obstacles):
            y = base + 0.33 - 0.66 * index / max(count - 1, 1)
            colour = OBSTACLE_COLOURS[index % len(OBSTACLE_COLOURS)]
            axes.plot([start, placed.x_m], [y, y], color=KERB, lw=0.8, zorder=1)
            known = record.knowledge.get(true_name(street, placed.obstacle_id))
            if known is None:
                continue
            seen_x = known.seen.street_x_m if known.seen else placed.x_m
            if known.told is not None and known.told.street_x_m < seen_x:
                axes.plot([known.told.street_x_m, seen_x], [y, y], color=colour, lw=3, alpha=0.35, zorder=2)
            if known.advised is not None:
                axes.plot(known.advised.street_x_m, y, marker="^", ms=7, color=colour, zorder=4)
            if known.seen is not None and seen_x < placed.x_m:
                axes.plot([seen_x, placed.x_m], [y, y], color=colour, lw=5, solid_capstyle="butt", zorder=3)
            axes.plot(placed.x_m, y, marker="|", ms=9, color=INK, zorder=4)
    axes.set(xlim=(-12, street.length_m), ylim=(-len(records) + 0.4, 0.6), yticks=[])
    axes.set_xlabel("where the car is along the street, m", color=INK)
    axes.set_title(
        "What each car knew when: pale = told by the server, triangle = driver advised, solid = seen by its own LiDAR, "
        "tick = reached",
        loc="left",
        fontsize=10,
        color=INK,
    )
    axes.spines[["top", "left", "right"]].set_visible(False)


def _svg(figure: Figure) -> str:
    buffer = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": "headsup", "font.family": "DejaVu Sans"}):
        figure.savefig(buffer, format="svg", dpi=150, metadata={"Date": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]
