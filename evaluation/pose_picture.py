"""What the pose looks like: errors inside their stated bounds, tracks, coverage, and a bent sweep made straight."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Ellipse
from numpy.typing import NDArray

from evaluation.figure_style import INK, SOFT, new_figure, save
from evaluation.odometry_accuracy import Deskewed
from evaluation.pose_accuracy import ASKED_SHARE, CHI_SQUARE_95, PoseTrace, inside_ellipse
from evaluation.pose_drives import PoseDrive

FloatArray = NDArray[np.float64]

BLUE, RED, GREEN = "#2f6bff", "#f0241a", "#1f9d55"
ELLIPSE_EVERY_M = 150.0


def draw_pose(
    path: Path,
    city: tuple[PoseDrive, PoseTrace] | None,
    loops: tuple[PoseDrive, PoseTrace] | None,
    coverage: Mapping[str, Sequence[PoseTrace]],
    sweep: Deskewed,
) -> None:
    """Four panels: the city drive's error, the loops' track, coverage by kind of receiver, a sweep before and after."""
    figure = new_figure(
        14.0,
        10.0,
        "The vehicle's pose",
        "Satellite fixes and odometry joined; what it says of its own error, and the truth",
    )
    error, track, share, points = (
        figure.add_axes(box)
        for box in (
            (0.06, 0.54, 0.42, 0.36),
            (0.55, 0.54, 0.42, 0.36),
            (0.20, 0.06, 0.28, 0.36),
            (0.55, 0.06, 0.42, 0.36),
        )
    )
    _draw_error(error, city)
    _draw_track(track, loops)
    _draw_coverage(share, coverage)
    _draw_sweep(points, sweep)
    save(figure, path)


def _title(axes: Axes, text: str) -> None:
    axes.set_title(text, fontsize=10.5, color=INK, loc="left")
    axes.tick_params(labelsize=8, colors=SOFT)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _draw_error(axes: Axes, city: tuple[PoseDrive, PoseTrace] | None) -> None:
    _title(axes, "Recorded city drive: horizontal error")
    if city is None:
        axes.text(0.5, 0.5, "no data", ha="center", color=SOFT)
        return
    _, trace = city
    largest = np.full(len(trace.time_s), math.nan)
    known = np.isfinite(trace.error_m[:, 0])
    largest[known] = np.sqrt(CHI_SQUARE_95 * np.linalg.eigvalsh(trace.covariance_m2[known])[:, -1])
    axes.fill_between(trace.time_s, 0, largest, color=BLUE, alpha=0.12, lw=0, label="95 % by its own account")
    axes.plot(trace.fix_time_s, np.hypot(*trace.fix_error_m.T), ".", ms=2.5, color=SOFT, label="fixes as stamped")
    axes.plot(trace.time_s, np.hypot(*trace.error_m.T), color=RED, lw=1.3, label="pose")
    axes.set_xlabel("s", fontsize=9, color=SOFT)
    axes.set_ylabel("m", fontsize=9, color=SOFT)
    axes.set_ylim(0, 3)
    axes.legend(fontsize=8, frameon=False, loc="upper right", ncols=3)


def _draw_track(axes: Axes, loops: tuple[PoseDrive, PoseTrace] | None) -> None:
    _title(axes, "Recorded loops, a fix a second: 95 % ellipses, ten times enlarged")
    if loops is None:
        axes.text(0.5, 0.5, "no data", ha="center", color=SOFT)
        return
    drive, trace = loops
    place = drive.place_m + trace.error_m
    axes.plot(*drive.place_m.T, color=SOFT, lw=0.8, label="truth")
    axes.plot(*place.T, color=BLUE, lw=1.0, label="pose")
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(drive.place_m, axis=0).T))])
    for along in np.arange(ELLIPSE_EVERY_M, way[-1], ELLIPSE_EVERY_M):
        k = int(np.searchsorted(way, along))
        if np.isfinite(trace.error_m[k, 0]):
            _draw_ellipse(axes, place[k], trace.covariance_m2[k], 10.0)
    axes.set_aspect("equal")
    axes.legend(fontsize=8, frameon=False)


def _draw_ellipse(axes: Axes, centre: FloatArray, covariance: FloatArray, times: float) -> None:
    values, vectors = np.linalg.eigh(covariance)
    width, height = 2 * times * np.sqrt(CHI_SQUARE_95 * values)
    angle = math.degrees(math.atan2(vectors[1, 0], vectors[0, 0]))
    axes.add_patch(Ellipse((centre[0], centre[1]), width, height, angle=angle, fill=False, color=RED, lw=0.8))


def _draw_coverage(axes: Axes, coverage: Mapping[str, Sequence[PoseTrace]]) -> None:
    _title(axes, "Moments whose 95 % ellipse holds the truth, all drives and each")
    axes.axvspan(*ASKED_SHARE, color=GREEN, alpha=0.12, lw=0)
    for row, traces in enumerate(coverage.values()):
        each = [float(inside_ellipse(trace).mean()) for trace in traces]
        axes.plot(each, np.full(len(each), row), ".", color=SOFT, ms=4)
        axes.plot([float(np.concatenate([inside_ellipse(t) for t in traces]).mean())], [row], "o", color=BLUE, ms=8)
    axes.set_yticks(range(len(coverage)), list(coverage))
    axes.set_xlim(-0.02, 1.02)
    axes.invert_yaxis()


def _draw_sweep(axes: Axes, sweep: Deskewed) -> None:
    _title(axes, f"One sweep of 64 rings, {sweep.manoeuvre.name}")
    high = sweep.truth_m[:, 2] > -1.0
    for points, colour, name in ((sweep.raw_m, RED, "as measured"), (sweep.deskewed_m, BLUE, "motion taken out")):
        axes.plot(*points[high, :2].T, ",", color=colour, alpha=0.6)
        axes.plot([], [], "s", color=colour, ms=5, label=name)
    axes.set_aspect("equal")
    axes.set_xlim(-30, 30)
    axes.set_ylim(-15, 15)
    axes.legend(fontsize=8, frameon=False, loc="upper right", ncols=2)
