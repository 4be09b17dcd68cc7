"""Roads of a street from those of a map: one for each lane section, wide from edge to edge of what is paved."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import groupby

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from simulator.maps.opendrive import LaneMark, OpenDriveLane, OpenDriveRoad
from simulator.streets.centreline import SAMPLE_M, Centreline
from simulator.streets.road import Opening, Road, Section
from simulator.streets.road_layout import LINE_WIDTH_M, Layout, PaintedLine

FloatArray = NDArray[np.float64]

DRIVEN = ("driving", "bidirectional")
LEVEL = (
    *DRIVEN,
    "shoulder",
    "parking",
    "stop",
    "biking",
    "entry",
    "exit",
    "onramp",
    "offramp",
    "border",
    "restricted",
    "roadworks",
    "tram",
)
"""Kinds of lanes at the height of the road: asphalt where they lie beside a driven lane."""

SHORTEST_M, NARROWEST_M = 0.05, 0.5
"""Of a road that is drawn: less is a slip of the map's maker."""

OVERDRAWN_M = 0.02
"""Roads are drawn this far beyond their ends: sections are sampled up to a millimetre from theirs."""

EDGE_INSET_M = 0.10
"""A line on a carriageway's edge is painted this far inside it."""

DOUBLE_HALF_GAP_M = 0.12
"""Between the middles of a double line and its own middle."""

DASHES = {
    "solid": (False,),
    "broken": (True,),
    "bottsdots": (True,),
    "solidsolid": (False, False),
    "solidbroken": (False, True),
    "brokensolid": (True, False),
    "brokenbroken": (True, True),
}
"""Which of a mark's lines are dashed, from left to right; kerbs, grass and what is unknown are not painted."""

NARROWEST_BAY_M = 1.8
"""Of a parking lane: a car without its mirrors."""

LINE_WIDTHS_M = (0.08, 0.4)
LEAST_PAVEMENT_M = 0.8
INTRUSION_STEP_M, BESIDE_M = 0.5, (0.15, 0.9, 1.7, 2.5)
"""Where, outward from the edge, borders would stand on another road."""

AT_ENDS_M = 0.15
"""Roads that follow each other overlap by less: there nothing is interrupted."""


def roads_of(road: OpenDriveRoad) -> list[Road]:
    """A road for each lane section that has a driven lane and is long enough to be drawn."""
    sections = (list(lanes) for _, lanes in groupby(road.lanes, key=lambda lane: lane.key.section))
    drawn = [_road(lanes, connecting=road.junction_id != -1) for lanes in sections]
    return [one for one in drawn if one is not None]


def opened_where_they_meet(roads: Sequence[Road]) -> list[Road]:
    """The roads with their borders interrupted where those would stand on another one's carriageway."""
    surfaces = [_Surface(road) for road in roads]
    opened = []
    for road, own in zip(roads, surfaces, strict=True):
        others = [other for other in surfaces if other is not own and other.is_near(own)]
        opened.append(road.opened(*(opening for side in (1, -1) for opening in _intrusions(road, side, others))))
    return opened


class _Surface:
    """A carriageway sampled along its middle: whether positions lie on it, without the search for each one's foot."""

    def __init__(self, road: Road) -> None:
        count = max(2, math.ceil(road.line.length_m / INTRUSION_STEP_M) + 1)
        s = np.linspace(road.line.start_m, road.line.end_m, count)
        at = road.line.at(s)
        self._points, self._half = at.position_m[:, :2], road.half_width(s)
        self._ahead = np.stack([np.cos(at.heading_rad), np.sin(at.heading_rad)], axis=1)
        self._tree = cKDTree(self._points)
        around = float(self._half.max()) + BESIDE_M[-1]
        self._low, self._high = self._points.min(axis=0) - around, self._points.max(axis=0) + around

    def is_near(self, other: _Surface) -> bool:
        """Whether the boxes of two roads and their borders overlap."""
        return bool((self._low < other._high).all() and (other._low < self._high).all())

    def holds(self, xy_m: FloatArray) -> NDArray[np.bool_]:
        """Whether positions (N, 2) lie on the carriageway."""
        distance, nearest = self._tree.query(xy_m)
        index = np.asarray(nearest)
        along = np.einsum("ij,ij->i", xy_m - self._points[index], self._ahead[index])
        beyond = ((index == 0) & (along <= 0)) | ((index == len(self._points) - 1) & (along >= 0))
        return np.asarray((distance <= self._half[index]) & ~beyond)


def _road(lanes: list[OpenDriveLane], *, connecting: bool) -> Road | None:
    paved = _paved(lanes)
    if not paved:
        return None
    left, right = paved[0].left_m, paved[-1].right_m
    line = _line((left + right) / 2)
    if line is None or np.hypot(*(left - right)[:, :2].T).max() < NARROWEST_M:
        return None
    s_m = np.linspace(line.start_m, line.end_m, len(left))
    half = (_offset(line, left, s_m) - _offset(line, right, s_m)) / 2
    driven = [lane for lane in paved if lane.kind in DRIVEN]
    layout = Layout(
        s_m=s_m,
        half_width_m=np.maximum(half, NARROWEST_M / 2),
        slope=np.interp(s_m, line.project(paved[0].centre_m[:, :2])[0], np.tan(paved[0].superelevation_rad)),
        lanes_m=np.array([_offset(line, lane.centre_m, s_m) for lane in driven]),
        lines=() if connecting else _lines(line, paved),
        parking=(_is_bay(paved[0]), _is_bay(paved[-1])),
    )
    outside = lanes[: lanes.index(paved[0])], lanes[lanes.index(paved[-1]) + 1 :]
    pavements = [sum(float(lane.width_m.mean()) for lane in beside if lane.kind == "sidewalk") for beside in outside]
    section = Section(
        lanes=tuple(1 if lane.travels_along_s else -1 for lane in reversed(driven)),
        lane_width_m=float(np.mean([lane.width_m.mean() for lane in driven])),
        crown_slope=0.0,
        pavement_width_m=max(*pavements, LEAST_PAVEMENT_M),
    )
    kerbs = pavements[0] >= LEAST_PAVEMENT_M, pavements[1] >= LEAST_PAVEMENT_M
    return Road(line, section, kerbs=kerbs, layout=layout, connecting=connecting)


def _paved(lanes: list[OpenDriveLane]) -> list[OpenDriveLane]:
    """All from the first driven lane to the last, medians too, and what lies level beside them."""
    driven = [index for index, lane in enumerate(lanes) if lane.kind in DRIVEN]
    if not driven:
        return []
    first, last = driven[0], driven[-1]
    while first > 0 and lanes[first - 1].kind in LEVEL:
        first -= 1
    while last + 1 < len(lanes) and lanes[last + 1].kind in LEVEL:
        last += 1
    return lanes[first : last + 1]


def _is_bay(lane: OpenDriveLane) -> bool:
    return lane.kind == "parking" and float(lane.width_m.min()) >= NARROWEST_BAY_M


def _line(middle_m: FloatArray) -> Centreline | None:
    """A line through (K, 3) points and a little on; None where they are too close together."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(middle_m[:, :2], axis=0).T))])
    if along[-1] < SHORTEST_M or not (np.diff(along) > 0).all():
        return None
    count = max(4, math.ceil((along[-1] + 2 * OVERDRAWN_M) / SAMPLE_M) + 1)
    s = np.linspace(-OVERDRAWN_M, along[-1] + OVERDRAWN_M, count)
    return Centreline(s, CubicSpline(along, middle_m)(s))


def _offset(line: Centreline, points_m: FloatArray, s_m: FloatArray) -> FloatArray:
    """Offset to the left, at distances (K,), of a line through points (N, 3)."""
    s, t = line.project(points_m[:, :2])
    return np.interp(s_m, s, t)


def _lines(line: Centreline, paved: list[OpenDriveLane]) -> tuple[PaintedLine, ...]:
    """What is painted on the edges of the lanes, each line once."""
    leftmost = [
        painted for mark in paved[0].left_marks for painted in _painted(line, paved[0], mark, paved[0].left_m, 1)
    ]
    return (
        *leftmost,
        *(
            painted
            for lane in paved
            for mark in lane.right_marks
            for painted in _painted(line, lane, mark, lane.right_m, -1 if lane is paved[-1] else 0)
        ),
    )


def _painted(
    line: Centreline, lane: OpenDriveLane, mark: LaneMark, edge_m: FloatArray, border: int
) -> list[PaintedLine]:
    """The lines of a mark on an edge (K, 3), which is the carriageway's on the left (1), on the right (-1), or not."""
    dashed = DASHES.get(mark.kind, ())
    s, t = line.project(edge_m[:, :2])
    width = min(max(mark.width_m or LINE_WIDTH_M, LINE_WIDTHS_M[0]), LINE_WIDTHS_M[1])
    inwards = border * (EDGE_INSET_M + width / 2 + (len(dashed) - 1) * DOUBLE_HALF_GAP_M)
    # At the ends of a section the line goes on to the end of what is drawn.
    from_m = line.start_m if mark.from_m <= lane.s_m[0] else float(np.interp(mark.from_m, lane.s_m, s))
    to_m = line.end_m if mark.to_m >= lane.s_m[-1] else float(np.interp(mark.to_m, lane.s_m, s))
    offsets = (DOUBLE_HALF_GAP_M, -DOUBLE_HALF_GAP_M) if len(dashed) == 2 else (0.0,)
    colour = "yellow" if mark.colour == "yellow" else "white"
    return [
        PaintedLine(np.stack([s, t - inwards + beside], axis=1), from_m, to_m, width, one, 1.0, colour)
        for beside, one in zip(offsets, dashed, strict=False)
    ]


def _intrusions(road: Road, side: int, others: Sequence[_Surface]) -> list[Opening]:
    """Where the borders of one side would stand on others."""
    first, last = road.line.start_m + AT_ENDS_M, road.line.end_m - AT_ENDS_M
    if last <= first:
        return []
    count = max(2, round((last - first) / INTRUSION_STEP_M) + 1)
    s, beside = np.linspace(first, last, count), np.array(BESIDE_M)
    t = side * (road.half_width(s)[:, None] + beside)
    plan = road.line.plan(np.repeat(s, len(beside)), t.ravel())
    taken = np.zeros(len(plan), dtype=bool)
    for other in others:
        taken |= other.holds(plan)
    taken_at = np.asarray(taken.reshape(count, len(beside)).any(axis=1))
    half_step = (last - first) / (count - 1) / 2
    runs = [list(run) for is_taken, run in groupby(range(count), key=lambda index: taken_at[index]) if is_taken]
    return [Opening(float(s[run[0]]) - half_step, float(s[run[-1]]) + half_step, side) for run in runs]
