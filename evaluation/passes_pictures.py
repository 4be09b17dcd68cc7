"""Pictures of passes: repeatability against speed, sensor and sweeps; boxes on what they were measured from."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

SIZES = ("S", "M", "L")
GOALS = {"front and rear": {"S": 6.0, "M": 2.5, "L": 1.5}, "front": {"S": 7.5, "M": 3.5, "L": 5.0}}
"""Standard deviations of the box area in per cent that one pass should keep."""

COLOURS = {"S": "#d97706", "M": "#2563eb", "L": "#059669"}
DPI = 130

Record = dict[str, Any]


def draw_repeatability(path: Path, records: Sequence[Record]) -> None:
    """Three panels: by sensor and view, by number of sweeps, by speed in the car's own lane."""
    figure = Figure(figsize=(13.0, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    by_view, by_sweeps, by_speed = figure.subplots(1, 3)
    holes = [record for record in records if record["obstacle"] in SIZES]
    _by_view(by_view, holes)
    _by_sweeps(by_sweeps, [record for record in holes if record["view"] == "front and rear"])
    _by_speed(by_speed, holes)
    for axes in (by_view, by_sweeps, by_speed):
        axes.set_ylabel("box area of one pass, standard deviation in %")
        axes.set_ylim(bottom=0.0)
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=DPI)


def _whole(records: Sequence[Record]) -> list[Record]:
    """Of each sensor, view and size the record with most sweeps."""
    best: dict[tuple[str, str, str], Record] = {}
    for record in records:
        key = record["sensor"], record["view"], record["obstacle"]
        if key not in best or record["sweeps"] > best[key]["sweeps"]:
            best[key] = record
    return list(best.values())


def _by_view(axes: Axes, records: Sequence[Record]) -> None:
    groups = list(dict.fromkeys((record["sensor"], record["view"]) for record in records))
    for offset, size in zip((-0.25, 0.0, 0.25), SIZES, strict=True):
        chosen = {(r["sensor"], r["view"]): r["area_sd"] for r in _whole(records) if r["obstacle"] == size}
        places = np.arange(len(groups)) + offset
        axes.bar(places, [chosen.get(group, np.nan) for group in groups], 0.22, color=COLOURS[size], label=size)
        for place, (_, view) in zip(places, groups, strict=True):
            axes.plot([place - 0.12, place + 0.12], [GOALS[view][size]] * 2, color="black", linewidth=1.5)
    axes.set_xticks(range(len(groups)), [f"{sensor}\n{view}" for sensor, view in groups], fontsize=8)
    axes.set_title("by sensor and view; black: the goal", fontsize=10)
    axes.legend(fontsize=8)


def _by_sweeps(axes: Axes, records: Sequence[Record]) -> None:
    for sensor, style in zip(dict.fromkeys(r["sensor"] for r in records), ("-o", "--s", ":^"), strict=False):
        for size in SIZES:
            line = sorted(
                (r["sweeps"], r["area_sd"]) for r in records if (r["sensor"], r["obstacle"]) == (sensor, size)
            )
            axes.plot(*np.array(line).T, style, color=COLOURS[size], label=f"{sensor} {size}", markersize=4)
    axes.set_xlabel("sweeps that see the place")
    axes.set_title("by number of sweeps, front and rear", fontsize=10)
    axes.legend(fontsize=7, ncols=3)


def _by_speed(axes: Axes, records: Sequence[Record]) -> None:
    whole = [record for record in _whole(records) if record["view"] == "front and rear"]
    speeds = sorted({int(name.split("_")[1]) for record in whole for name in record if name.startswith("at_")})
    for sensor, style in zip(dict.fromkeys(r["sensor"] for r in whole), ("-o", "--s", ":^"), strict=False):
        for record in (r for r in whole if r["sensor"] == sensor):
            values = [record.get(f"at_{speed}_kmh_area_sd", np.nan) for speed in speeds]
            label = f"{sensor} {record['obstacle']}"
            axes.plot(speeds, values, style, color=COLOURS[record["obstacle"]], label=label, markersize=4)
    axes.set_xlabel("speed in km/h")
    axes.set_xticks(speeds)
    axes.set_title("by speed, own lane, front and rear", fontsize=10)
    axes.legend(fontsize=7, ncols=3)
