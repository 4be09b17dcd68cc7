"""A picture of a whole recording: the street from above, who drives when, what lies on it, and what was seen."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec, SubplotSpec
from numpy.typing import NDArray

from simulator.changes import APPEARED, GROWN, REMOVED
from simulator.overview.outlines import draw_outlines, outlines
from simulator.overview.plan import draw_plan, plan_height
from simulator.overview.sights import Sight
from simulator.overview.style import EGO_COLOURS, INK, KIND_COLOURS, PAPER, QUIET, headline, note, without_frame
from simulator.overview.times import draw_times, driven_m
from simulator.readings import Sweep
from simulator.scenario import Scenario
from simulator.scene.scenery import Surface

FloatArray = NDArray[np.float64]

WIDTH_IN, DPI = 16.0, 110
TITLE_IN, MARGIN_IN, GAP_IN = 0.65, 0.4, 0.6
TIMES_IN, OUTLINES_IN, PICTURES_IN = 3.6, 1.7, 2.35

AHEAD_M, BEHIND_M, BESIDE_M = 26.0, 6.0, 9.0
"""Of the sweep from above: what a turn shows of the road within half a second of driving and more."""

STYLE = {"font.family": ["DejaVu Sans"], "font.size": 9.0, "axes.edgecolor": QUIET, "text.color": INK}

SURFACE_COLOURS = {
    Surface.ROAD: "#9aa0a6",
    Surface.ROAD_MARK: "#5f6368",
    Surface.KERB: "#6b4f3a",
    Surface.PAVEMENT: "#c9b79c",
    Surface.GROUND: "#b7c9a0",
    Surface.CAR: "#4d5bd1",
    Surface.WHEEL: "#4d5bd1",
    Surface.PEDESTRIAN: "#d13fa8",
    Surface.TREE: "#5d9b4f",
    Surface.TRUNK: "#5d9b4f",
    Surface.DEBRIS: "#0077b6",
}
OTHER_COLOUR = "#d0d0d0"

WHAT_HAPPENED = {
    APPEARED: ("is not there yet", "has appeared"),
    GROWN: ("before it grows", "has grown"),
    REMOVED: ("before it goes", "is gone"),
}


def overview(happening: Scenario, sights: Sequence[Sight]) -> bytes:
    """PNG of a recording; the same scenario and sights give the same bytes."""
    with mpl.rc_context(dict(mpl.rcParamsDefault) | STYLE):
        figure = _figure(happening, sights)
        content = io.BytesIO()
        figure.savefig(content, format="png", metadata={"Software": None})
    return content.getvalue()


def _figure(happening: Scenario, sights: Sequence[Sight]) -> Figure:
    heights = [
        plan_height(happening, WIDTH_IN - 2 * MARGIN_IN),
        TIMES_IN,
        OUTLINES_IN,
        *([PICTURES_IN] if sights else []),
    ]
    total_in = TITLE_IN + sum(heights) + GAP_IN * len(heights)
    figure = Figure(figsize=(WIDTH_IN, total_in), dpi=DPI, facecolor=PAPER)
    FigureCanvasAgg(figure)
    margin, top = MARGIN_IN / WIDTH_IN, 1 - TITLE_IN / total_in
    space = GAP_IN * len(heights) / sum(heights)
    rows = GridSpec(
        len(heights), 1, figure, margin, MARGIN_IN / total_in, 1 - margin, top, hspace=space, height_ratios=heights
    )
    draw_plan(figure.add_subplot(rows[0]), happening)
    _draw_middle(figure, rows[1], happening, sights)
    draw_outlines(figure.add_subplot(rows[2]), happening)
    for column, sight in enumerate(sights):
        _draw_picture(figure.add_subplot(rows[3].subgridspec(1, len(sights), wspace=0.03)[0, column]), happening, sight)
    figure.text(margin, 1 - 0.42 / total_in, _title(happening), fontsize=14, weight="bold")
    figure.text(1 - margin, 1 - 0.42 / total_in, _setting(happening), fontsize=9.5, ha="right", color=QUIET)
    return figure


def _draw_middle(figure: Figure, row: SubplotSpec, happening: Scenario, sights: Sequence[Sight]) -> None:
    """The course of the drive, beside it the sweep with the most points on obstacles."""
    swept = [(sight, sight.sweep) for sight in sights if sight.sweep is not None]
    columns = row.subgridspec(1, 3, width_ratios=(0.03, 1.0, 0.9 if swept else 0.01), wspace=0.04)
    draw_times(figure.add_subplot(columns[0, 1]), happening)
    if swept:
        best = max(swept, key=lambda pair: np.count_nonzero(pair[1].obstacle_id))
        _draw_sweep(figure.add_subplot(columns[0, 2]), happening, *best)


def _title(happening: Scenario) -> str:
    plan, vehicles = happening.plan, len(happening.egos)
    obstacles, changes = len(happening.changing.street.obstacles), len(happening.changing.changes)
    return (
        f"Seed {plan.seed}: {vehicles} vehicle{'s' * (vehicles > 1)}, {plan.seconds:g} s each, "
        f"{obstacles} obstacles, {changes} change{'s' * (changes != 1)}"
    )


def _setting(happening: Scenario) -> str:
    street, place = happening.changing.street, happening.changing.street.georeference.position
    start_m, end_m = driven_m(happening)
    sun_deg = math.degrees(math.asin(float(happening.daylight.sun_direction[2])))
    return (
        f"{abs(place.latitude_deg):.2f}° {'N' if place.latitude_deg >= 0 else 'S'}, "
        f"{abs(place.longitude_deg):.2f}° {'E' if place.longitude_deg >= 0 else 'W'} · {end_m - start_m:.0f} m · "
        f"roughness ISO 8608 {street.roughness.name} · sun {sun_deg:.0f}° high"
    )


def _draw_sweep(axes: Axes, happening: Scenario, sight: Sight, sweep: Sweep) -> None:
    """A turn from above, the way of the vehicle to the right, each point in the colour of its label."""
    turn = sight.vehicle_from_sensor
    x, y = (sweep.points_m @ turn[:3, :3].T + turn[:3, 3])[:, :2].T
    inside = (x > -BEHIND_M) & (x < AHEAD_M) & (np.abs(y) < BESIDE_M)
    colours = np.array([mpl.colors.to_rgb(SURFACE_COLOURS.get(Surface(v), OTHER_COLOUR)) for v in range(len(Surface))])
    known = np.minimum(sweep.surface, len(Surface) - 1)
    quiet = inside & (sweep.obstacle_id == 0)
    axes.scatter(x[quiet], y[quiet], s=1.3, c=colours[known[quiet]], linewidths=0)
    street = happening.changing.at(sight.time_s)
    for placed in street.obstacles:
        on = inside & (sweep.obstacle_id == placed.obstacle_id)
        axes.scatter(x[on], y[on], s=4.0, color=KIND_COLOURS[placed.kind], linewidths=0)
        if on.any():
            top = np.array([x[on].mean(), y[on].max()])
            note(axes, str(placed.obstacle_id), top, (0, 8), KIND_COLOURS[placed.kind], weight="bold")
    axes.plot([-2.1, -2.1, 1.5, 2.2, 1.5, -2.1], [-0.9, 0.9, 0.9, 0, -0.9, -0.9], color=EGO_COLOURS[sight.moment.ego])
    axes.set(xlim=(-BEHIND_M, AHEAD_M), ylim=(-BESIDE_M, BESIDE_M), aspect="equal")
    without_frame(axes)
    labelled = int((sweep.obstacle_id > 0).sum())
    whose = f"LiDAR of ego{sight.moment.ego} at {sight.time_s:.1f} s, from above, by label"
    headline(axes, f"{whose}: {len(x):,} points, {labelled:,} of them on obstacles")


def _draw_picture(axes: Axes, happening: Scenario, sight: Sight) -> None:
    height, width = sight.pixels.shape[:2]
    axes.imshow(sight.pixels[..., ::-1], extent=(0, width, height, 0), interpolation="antialiased")
    street = happening.changing.at(sight.time_s)
    for placed in street.obstacles:
        for outline in outlines(placed):
            z = street.sound_height(*outline.T)
            pixels = _projected(sight, np.column_stack([outline, z]))
            if pixels is not None:
                line, closed = "--" if placed.filled else "-", np.vstack([pixels, pixels[:1]])
                axes.plot(*closed.T, line, color=KIND_COLOURS[placed.kind], linewidth=1.0)
    axes.set(xlim=(0, width), ylim=(height, 0))
    without_frame(axes)
    told = f"ego{sight.moment.ego}, {sight.time_s:.1f} s{_what(happening, sight)}"
    headline(axes, told, color=EGO_COLOURS[sight.moment.ego], weight="bold")


def _what(happening: Scenario, sight: Sight) -> str:
    """What lies ahead, and what has become of it."""
    number = sight.moment.obstacle_id
    if not number:
        return ""
    named = f": {happening.changing.street.obstacle(number).kind.value} {number}"
    change = next((change for change in happening.changing.changes if change.obstacle_id == number), None)
    if change is None:
        return f"{named} ahead"
    before, after = WHAT_HAPPENED[change.what]
    return f"{named} {before if sight.time_s < change.time_s else after}"


def _projected(sight: Sight, points_m: FloatArray) -> FloatArray | None:
    """Pixels (N, 2) of points (N, 3), frame `street`; None where one is behind or beside the picture."""
    camera_from_street = np.linalg.inv(sight.street_from_camera)
    seen = points_m @ camera_from_street[:3, :3].T + camera_from_street[:3, 3]
    if seen[:, 2].min() < 1.0:
        return None
    pixels = seen @ sight.camera.matrix.T
    pixels = pixels[:, :2] / pixels[:, 2:]
    return pixels if (np.abs(pixels).max() < 4 * sight.camera.width_px) else None
