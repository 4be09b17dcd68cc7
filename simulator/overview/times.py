"""Who is where on the road when, and what lies there when."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from contract.geometry import Kind
from simulator.changes import APPEARED, GROWN, Change
from simulator.overview.style import (
    CHANGE_MARKS,
    EGO_COLOURS,
    KIND_COLOURS,
    LABEL_GAP_PX,
    PAPER,
    QUIET,
    headline,
    note,
)
from simulator.scenario import Scenario
from simulator.streets.centreline import Centreline

FloatArray = NDArray[np.float64]

BEYOND_M = 28.0
ROAD_M = 9.0
"""What lies farther beside the egos' way is on another road; a lane is 3.5 m wide."""


def way(happening: Scenario) -> Centreline:
    """What all egos drive along."""
    return happening.egos[0].trajectory.path.line


def driven_m(happening: Scenario) -> tuple[float, float]:
    """From where to where on their way the egos drive."""
    end_s = happening.plan.seconds
    ends = [ego.trajectory.distance(np.array([ego.start_s, ego.start_s + end_s])) for ego in happening.egos]
    return float(np.min(ends)), float(np.max(ends))


def draw_times(axes: Axes, happening: Scenario) -> None:
    """Distance on the egos' way to the right, from where the last one starts; time upwards."""
    end_s = max(ego.start_s for ego in happening.egos) + happening.plan.seconds
    start, end = driven_m(happening)
    low, high = -BEYOND_M, end - start + BEYOND_M
    changes = {change.obstacle_id: change for change in happening.changing.changes}
    _draw_traffic(axes, happening, end_s)
    last_m, gap_m = -math.inf, LABEL_GAP_PX * (high - low) / axes.get_window_extent().width
    obstacles = happening.changing.street.obstacles
    along, beside = way(happening).project(np.array([[o.x_m, o.y_m] for o in obstacles]).reshape(-1, 2))
    for index in np.argsort(along):
        placed, at = obstacles[index], float(along[index]) - start
        change = changes.get(placed.obstacle_id)
        if abs(beside[index]) > ROAD_M:
            continue
        if not low < at < high:
            continue
        _draw_life(axes, placed.kind, at, change, end_s)
        if change is not None or at - last_m > gap_m:
            last_m = at
            top = np.array([at, end_s])
            note(axes, str(placed.obstacle_id), top, (0, 6), KIND_COLOURS[placed.kind], weight="bold")
    axes.set(xlim=(low, high), ylim=(0, end_s), xlabel="distance on the way of the vehicles, m", ylabel="time, s")
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(colors=QUIET, labelsize=8)
    headline(axes, "Who passes what, when:  ▲ grown  ● appeared  ✖ repaired or taken away", pad=14)


def _draw_traffic(axes: Axes, happening: Scenario, end_s: float) -> None:
    """The egos, and thin lines for all others that stay on their road."""
    line, start_m, times = way(happening), driven_m(happening)[0], np.linspace(0, end_s, 120)
    for mover in happening.movers:
        s, t = line.project(mover.motion.poses(times)[:, :2, 3])
        if np.abs(t).max() < ROAD_M:
            axes.plot(s - start_m, times, color="#c9ced6", linewidth=0.8, zorder=1)
    for number, (ego, colour) in enumerate(zip(happening.egos, EGO_COLOURS, strict=False)):
        driven_s = np.linspace(ego.start_s, ego.start_s + happening.plan.seconds, 120)
        s = ego.trajectory.distance(driven_s) - start_m
        axes.plot(s, driven_s, color=colour, linewidth=2.0, zorder=3)
        start = np.array([s[0], driven_s[0]])
        note(axes, f"ego{number}", start, (-5, 5 + 8 * number), colour, weight="bold", ha="right")


def _draw_life(axes: Axes, kind: Kind, at_m: float, change: Change | None, end_s: float) -> None:
    """An obstacle's time on the road: a line, wider once it has grown, and a mark where it changes."""
    colour, what = KIND_COLOURS[kind], change.what if change else None
    change_s = change.time_s if change else end_s
    if what != APPEARED:
        axes.plot([at_m, at_m], [0, change_s], color=colour, linewidth=2.0, alpha=0.55, zorder=2, solid_capstyle="butt")
    if what in (APPEARED, GROWN):
        width = 2.0 if what == APPEARED else 4.5
        axes.plot(
            [at_m, at_m], [change_s, end_s], color=colour, linewidth=width, alpha=0.55, zorder=2, solid_capstyle="butt"
        )
    if what is not None:
        axes.plot(
            [at_m], [change_s], marker=CHANGE_MARKS[what], color=colour, markersize=8, markeredgecolor=PAPER, zorder=4
        )
