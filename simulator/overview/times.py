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
from simulator.street import PlacedObstacle

FloatArray = NDArray[np.float64]

BEYOND_M = 28.0


def span_m(happening: Scenario) -> tuple[float, float]:
    """From where to where along the main road the egos drive, with a margin."""
    line, seconds = happening.changing.street.main.line, happening.plan.seconds
    ends = [
        line.project(ego.trajectory.poses(np.array([ego.start_s, ego.start_s + seconds]))[:, :2, 3])[0]
        for ego in happening.egos
    ]
    return float(np.min(ends)) - BEYOND_M, float(np.max(ends)) + BEYOND_M


def draw_times(axes: Axes, happening: Scenario) -> None:
    """Distance along the main road to the right, time upwards."""
    end_s = max(ego.start_s for ego in happening.egos) + happening.plan.seconds
    (low, high), changes = span_m(happening), {change.obstacle_id: change for change in happening.changing.changes}
    _draw_traffic(axes, happening, end_s)
    last_m, gap_m = -math.inf, LABEL_GAP_PX * (high - low) / axes.get_window_extent().width
    for placed in sorted(happening.changing.street.obstacles, key=lambda o: _along(happening, o)):
        at, change = _along(happening, placed), changes.get(placed.obstacle_id)
        if not low < at < high:
            continue
        _draw_life(axes, placed.kind, at, change, end_s)
        if change is not None or at - last_m > gap_m:
            last_m = at
            top = np.array([at, end_s])
            note(axes, str(placed.obstacle_id), top, (0, 6), KIND_COLOURS[placed.kind], weight="bold")
    axes.set(xlim=(low, high), ylim=(0, end_s), xlabel="distance along the road, m", ylabel="time, s")
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(colors=QUIET, labelsize=8)
    headline(axes, "Who passes what, when:  ▲ grown  ● appeared  ✖ repaired or taken away", pad=14)


def _draw_traffic(axes: Axes, happening: Scenario, end_s: float) -> None:
    """The egos, and thin lines for all others on the main road."""
    main, times = happening.changing.street.main, np.linspace(0, end_s, 120)
    for mover in happening.movers:
        s, t = main.line.project(mover.motion.poses(times)[:, :2, 3])
        if np.abs(t).max() < main.section.half_width_m:
            axes.plot(s, times, color="#c9ced6", linewidth=0.8, zorder=1)
    for number, (ego, colour) in enumerate(zip(happening.egos, EGO_COLOURS, strict=False)):
        driven = np.linspace(ego.start_s, ego.start_s + happening.plan.seconds, 120)
        s, _ = main.line.project(ego.trajectory.poses(driven)[:, :2, 3])
        axes.plot(s, driven, color=colour, linewidth=2.0, zorder=3)
        start = np.array([s[0], driven[0]])
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


def _along(happening: Scenario, placed: PlacedObstacle) -> float:
    return float(happening.changing.street.main.line.project(np.array([[placed.x_m, placed.y_m]]))[0][0])
