"""The street from above: roads, parked cars, the egos' ways, obstacles in true outline."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from matplotlib.transforms import ScaledTranslation
from numpy.typing import NDArray

from simulator.overview.outlines import outlines
from simulator.overview.style import EGO_COLOURS, INK, KIND_COLOURS, PAPER, note, without_frame
from simulator.overview.times import BEYOND_M, driven_m, way
from simulator.scenario import Scenario
from simulator.streets.road import Road

FloatArray = NDArray[np.float64]

ASPHALT, KERB = "#d9dce1", "#8d939c"
BESIDE_M = (0.0, 12.0)
CAR_HALF_M = (2.15, 0.89)
HEIGHT_IN, NOTES_IN = (0.6, 3.5), 0.9

MANY = 40
"""From here on the rings would touch."""

LETTER_PX = (9.0, 15.0)


def plan_height(happening: Scenario, width_in: float) -> float:
    """Height in inches of a plan so wide, of equal scale both ways."""
    low, high = _bounds(happening)
    return float(np.clip(width_in * (high[1] - low[1]) / (high[0] - low[0]), *HEIGHT_IN)) + NOTES_IN


def draw_plan(axes: Axes, happening: Scenario) -> None:
    """The street from above, turned so that the way of the first ego runs to the right."""
    turn, street = _turn(happening), happening.changing.street
    # Side roads first: the main road's edge lies over their mouths.
    for road in reversed(street.roads):
        _draw_road(axes, road, turn)
    for car in street.parked_cars:
        corners = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * CAR_HALF_M @ _rotation(-car.yaw_rad)
        colour = np.clip(car.colour, 0, 1) ** (1 / 2.2)
        axes.add_artist(
            Polygon(np.add(corners, (car.x_m, car.y_m)) @ turn, facecolor=colour, edgecolor=KERB, linewidth=0.3)
        )
    _draw_tracks(axes, happening, turn)
    low, high = _filling(axes, *_bounds(happening))
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    _draw_obstacles(axes, happening, turn)
    _draw_scale(axes, low, high)
    without_frame(axes)


def _filling(axes: Axes, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bounds about the same middle that fill the panel at one scale."""
    panel = axes.get_window_extent()
    sides = np.array([panel.width, panel.height])
    half = sides * ((high - low) / sides).max() / 2
    return (low + high) / 2 - half, (low + high) / 2 + half


def _draw_road(axes: Axes, road: Road, turn: FloatArray) -> None:
    """The carriageway and its painted lines; ways through a junction lie over each other and have no edges."""
    s = np.arange(road.line.start_m, road.line.end_m, 1.0)
    band = _band(road, s, road.half_width(s)) @ turn
    axes.add_artist(
        Polygon(band, facecolor=ASPHALT, edgecolor="none" if road.connecting else KERB, linewidth=0.6, zorder=0.8)
    )
    for line in road.lines():
        along = s[(s >= line.from_m) & (s <= line.to_m)]
        if len(along) > 1:
            way = road.line.plan(along, np.interp(along, *line.offset_m.T)) @ turn
            style = (0, (6, 6)) if line.dashed else "solid"
            axes.plot(*way.T, color=PAPER, linewidth=0.6, zorder=0.9, linestyle=style)


def _band(road: Road, s_m: FloatArray, half_width_m: FloatArray) -> FloatArray:
    """Outline (N, 2) of a strip along a road."""
    return np.concatenate([road.line.plan(s_m, half_width_m), road.line.plan(s_m, -half_width_m)[::-1]])


def _draw_tracks(axes: Axes, happening: Scenario, turn: FloatArray) -> None:
    """Each ego's way with its times; on the same lane they are set apart for the eye, by two points each."""
    for number, (ego, colour) in enumerate(zip(happening.egos, EGO_COLOURS, strict=False)):
        apart = axes.transData + ScaledTranslation(0, -2.2 * number / 72, axes.figure.dpi_scale_trans)
        end_s, step_s = ego.start_s + happening.plan.seconds, _mark_step_s(happening.plan.seconds)
        marks_s = np.arange(math.floor(ego.start_s / step_s + 1) * step_s, end_s, step_s)
        track, marks, start = (
            ego.trajectory.poses(times)[:, :2, 3] @ turn
            for times in (np.linspace(ego.start_s, end_s, 400), marks_s, np.array([ego.start_s]))
        )
        axes.plot(*track.T, color=colour, linewidth=1.8, transform=apart, zorder=3)
        axes.plot(*marks.T, ".", color=colour, markersize=6, transform=apart, zorder=3)
        axes.plot(*start.T, "s", color=colour, markersize=6, transform=apart, zorder=3)
        leader = {"arrowstyle": "-", "color": colour, "lw": 0.5, "shrinkA": 0, "shrinkB": 1}
        for time_s, place in zip(marks_s, marks, strict=True):
            note(axes, f"{time_s:g} s", place, (0, 24 + 10 * number), colour, arrowprops=leader, fontsize=7.5)
        note(
            axes,
            f"ego{number}, {ego.start_s:.1f} s",
            start[0],
            (0, 24 + 10 * number),
            colour,
            arrowprops=leader,
            weight="bold",
        )


def _draw_obstacles(axes: Axes, happening: Scenario, turn: FloatArray) -> None:
    """True outlines, each within a ring that is seen at any scale, with a word where there is room."""
    obstacles = happening.changing.street.obstacles
    changes = {change.obstacle_id: change for change in happening.changing.changes}
    ring_pt = 9 if len(obstacles) <= MANY else 5
    taken: list[tuple[FloatArray, int]] = []
    for placed in sorted(obstacles, key=lambda o: o.obstacle_id not in changes):
        colour, change = KIND_COLOURS[placed.kind], changes.get(placed.obstacle_id)
        for outline in outlines(placed):
            axes.add_artist(Polygon(outline @ turn, facecolor=colour, edgecolor=colour, linewidth=0.8, zorder=4))
        at = np.array([placed.x_m, placed.y_m]) @ turn
        axes.plot(*at, "o", markersize=ring_pt, markerfacecolor="none", markeredgecolor=colour, zorder=4)
        words = [
            f"{placed.obstacle_id}",
            *([f"{placed.obstacle_id} {change.what} {change.time_s:.1f} s"] if change else []),
        ]
        pixel = axes.transData.transform(at)
        for text in reversed(words):
            if all(_apart(pixel, text, *other) for other in taken):
                taken.append((pixel, len(text)))
                note(axes, text, at, (0, -14), colour, weight="bold")
                break


def _apart(pixel: FloatArray, text: str, other: FloatArray, other_letters: int) -> bool:
    """Whether two words below these places leave each other room."""
    dx, dy = np.abs(pixel - other)
    return bool(dx > LETTER_PX[0] * (len(text) + other_letters) / 2 or dy > LETTER_PX[1])


def _draw_scale(axes: Axes, low: FloatArray, high: FloatArray) -> None:
    length_m = 10.0 ** math.floor(math.log10((high[0] - low[0]) / 6))
    at = (0.985 - length_m / (high[0] - low[0]), 0.985)
    axes.plot(at, (0.03, 0.03), color=INK, linewidth=2, transform=axes.transAxes)
    axes.text(sum(at) / 2, 0.05, f"{length_m:g} m", ha="center", va="bottom", fontsize=8, transform=axes.transAxes)


def _turn(happening: Scenario) -> FloatArray:
    """(2, 2) that takes rows of street positions to the plan's: the chord of the egos' way runs to the right."""
    ends = way(happening).at(np.array(driven_m(happening))).position_m[:, :2]
    chord = ends[1] - ends[0]
    return _rotation(math.atan2(chord[1], chord[0]))


def _rotation(angle_rad: float) -> FloatArray:
    """(2, 2) by which rows of positions are turned back (clockwise) by an angle."""
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[cos, -sin], [sin, cos]])


def _bounds(happening: Scenario) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest position of what the plan shows, turned."""
    start, end = driven_m(happening)
    s = np.linspace(start - BEYOND_M, end + BEYOND_M, 200)
    points = way(happening).at(s).position_m[:, :2] @ _turn(happening)
    return points.min(axis=0) - BESIDE_M, points.max(axis=0) + BESIDE_M


def _mark_step_s(seconds: float) -> float:
    """Time between marks: some five of them."""
    steps: Sequence[float] = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50)
    return min(steps, key=lambda step: abs(step - seconds / 5))
