"""A road: a centreline with a cross-section, and where other roads join it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from simulator.streets.centreline import Centreline, alignment, straight
from simulator.streets.road_layout import Layout, PaintedLine

FloatArray = NDArray[np.float64]

CROWN_ROUNDING_M = 0.25
"""The crown is rounded over the middle half metre: a paver leaves no edge."""

BANK_PER_CURVATURE_M, STEEPEST_BANK = 2.5, 0.04
"""Curves lean inwards, 2.5 % at 100 m radius, at most 4 % (in towns ice and crossings forbid more)."""

OVERLAP_M = 0.3
"""A side road begins this far inside the road it joins, so that no gap shows where the edge is curved."""

MOUTH_BLEND_M = 8.0
"""Over this length a side road's surface leaves that of the road it joins."""

STOP_LINE_M = 7.5
"""A side road's traffic stops before the footway that crosses its mouth; its other lines begin there."""

EDGE_LINE_INSET_M, EDGE_LINE_WIDTH_M, EDGE_LINE_COVER = 0.3, 0.10, 0.75


@dataclass(frozen=True, slots=True)
class Section:
    """Cross-section: lanes from right to left with their directions (1 drives along s, -1 against), and borders.

    `crown_slope` falls from the middle to both sides; 0 for roads whose map already holds their cross fall.
    """

    lanes: tuple[int, ...] = (1, -1)
    lane_width_m: float = 3.5
    crown_slope: float = 0.02
    kerb_height_m: float = 0.12
    pavement_width_m: float = 2.0

    @property
    def half_width_m(self) -> float:
        """Half of the carriageway."""
        return len(self.lanes) * self.lane_width_m / 2

    def lane_offset_m(self, lane: int) -> float:
        """Middle of a lane, to the left of the centreline."""
        return (lane + 0.5) * self.lane_width_m - self.half_width_m


@dataclass(frozen=True, slots=True)
class Opening:
    """Where the borders of a road are interrupted: `side` is 1 left, -1 right."""

    start_m: float
    end_m: float
    side: int


@dataclass(frozen=True, slots=True, eq=False)
class Road:
    """A road through the frame `street`.

    `joins` is the road whose edge this one begins at, with kerbs rounded by `mouth_radius_m`. `kerbs` says on which
    sides, left and right, there are kerb and pavement instead of a plain verge. A `layout` replaces the section's
    lanes and widths. A `connecting` road leads through a junction and overlaps others of its kind: nothing is painted
    on it, nothing stands beside it.
    """

    line: Centreline
    section: Section = field(default_factory=Section)
    openings: tuple[Opening, ...] = ()
    joins: Road | None = None
    mouth_radius_m: float = 6.0
    kerbs: tuple[bool, bool] = (True, True)
    layout: Layout | None = None
    connecting: bool = False

    def half_width(self, s_m: FloatArray) -> FloatArray:
        """Half of the carriageway at distances (N,), wider where the mouth opens."""
        if self.layout is not None:
            return np.interp(s_m, self.layout.s_m, self.layout.half_width_m)
        width = np.full(np.shape(s_m), self.section.half_width_m)
        if self.joins is not None:
            radius = self.mouth_radius_m
            inside = np.clip(radius - (np.asarray(s_m) - self.line.start_m - OVERLAP_M), 0, radius)
            width += radius - np.sqrt(radius**2 - inside**2)
        return width

    def height(self, s_m: FloatArray, t_m: FloatArray) -> FloatArray:
        """Height of the sound, smooth road (N,) at distances s and offsets t."""
        stations = self.line.at(s_m)
        own = stations.position_m[:, 2] + self._crown(t_m) + self._slope(s_m, stations.curvature_per_m) * t_m
        if self.joins is None:
            return np.asarray(own)
        reach = np.clip((s_m - self.line.start_m) / MOUTH_BLEND_M, 0, 1)
        share = reach * reach * (3 - 2 * reach)
        return np.asarray((1 - share) * self._height_of(self.joins, s_m, t_m) + share * own)

    def cross_slope(self, s_m: FloatArray, t_m: FloatArray) -> FloatArray:
        """Derivative of the height by t (N,)."""
        step_m = 0.05
        return (self.height(s_m, t_m + step_m) - self.height(s_m, t_m - step_m)) / (2 * step_m)

    def holds(self, s_m: FloatArray, t_m: FloatArray) -> NDArray[np.bool_]:
        """Whether (s, t) (N,) lie on the carriageway."""
        inside = (s_m > self.line.start_m) & (s_m < self.line.end_m)
        return np.asarray(inside & (np.abs(t_m) <= self.half_width(s_m)))

    def lane_offsets(self, s_m: FloatArray) -> FloatArray:
        """Middles (lanes, N) of the lanes at distances (N,), to the left of the centreline."""
        if self.layout is not None:
            lanes = [np.interp(s_m, self.layout.s_m, lane) for lane in self.layout.lanes_m]
            return np.array(lanes).reshape(-1, len(s_m))
        offsets = [self.section.lane_offset_m(lane) for lane in range(len(self.section.lanes))]
        return np.repeat(np.array(offsets)[:, None], len(s_m), axis=1)

    def lines(self) -> tuple[PaintedLine, ...]:
        """Painted lines along the road: those of its layout, else dashes between lanes and edges up to openings."""
        if self.layout is not None:
            return self.layout.lines
        section, first = self.section, self.line.start_m + (STOP_LINE_M if self.joins is not None else 0.0)
        borders = [section.lane_offset_m(lane) + section.lane_width_m / 2 for lane in range(len(section.lanes) - 1)]
        dashes = [PaintedLine(_at_offset(t), first, self.line.end_m, dashed=True) for t in borders]
        edge = section.half_width_m - EDGE_LINE_INSET_M
        return (
            *dashes,
            *(
                PaintedLine(_at_offset(side * edge), start, end, EDGE_LINE_WIDTH_M, cover=EDGE_LINE_COVER)
                for side in (1, -1)
                for start, end in self.closed(side, 0.0, first, self.line.end_m)
            ),
        )

    def closed(self, side: int, margin_m: float, start_m: float, end_m: float) -> list[tuple[float, float]]:
        """Pieces of one side between two distances that leave its openings free by a margin."""
        gaps = sorted((o.start_m - margin_m, o.end_m + margin_m) for o in self.openings if o.side == side)
        pieces, begin = [], start_m
        for gap_start, gap_end in [*gaps, (end_m, end_m)]:
            if min(gap_start, end_m) > begin:
                pieces.append((begin, min(gap_start, end_m)))
            begin = max(begin, gap_end)
        return pieces

    def has_kerb(self, side: int) -> bool:
        """Whether there is a pavement on the left (1) or the right (-1)."""
        return self.kerbs[0 if side > 0 else 1]

    def has_parking(self, side: int) -> bool:
        """Whether a parking lane lies along the left (1) or the right (-1) edge."""
        return self.layout is not None and self.layout.parking[0 if side > 0 else 1]

    def opened(self, *openings: Opening) -> Road:
        """The road with more openings in its borders."""
        return replace(self, openings=(*self.openings, *openings))

    def _crown(self, t_m: FloatArray) -> FloatArray:
        return -self.section.crown_slope * (np.sqrt(np.square(t_m) + CROWN_ROUNDING_M**2) - CROWN_ROUNDING_M)

    def _slope(self, s_m: FloatArray, curvature_per_m: FloatArray) -> FloatArray:
        if self.layout is not None:
            return np.interp(s_m, self.layout.s_m, self.layout.slope)
        # In a left curve (positive) the right side, t < 0, is the outer one and lies higher.
        return -np.clip(BANK_PER_CURVATURE_M * curvature_per_m, -STEEPEST_BANK, STEEPEST_BANK)

    def _height_of(self, joined: Road, s_m: FloatArray, t_m: FloatArray) -> FloatArray:
        """The surface of the road this one joins, drawn on beyond its edge at the edge's height."""
        s, t = joined.line.project(self.line.plan(s_m, t_m))
        edge = joined.half_width(s)
        return joined.height(s, np.clip(t, -edge, edge))


def _at_offset(t_m: float) -> FloatArray:
    return np.array([[0.0, t_m]])


def straight_road(length_m: float, beyond_m: float, section: Section | None = None) -> Road:
    """A level road along x from `-beyond_m` to `length_m + beyond_m`."""
    return Road(straight(-beyond_m, length_m + beyond_m), section or Section())


def side_road(
    main: Road, s_m: float, side: int, bend_rad: float, length_m: float, grade: float, section: Section
) -> tuple[Road, Road]:
    """`main` with an opening, and the road that leaves it square at s to `side` and then bends by `bend_rad`.

    It climbs by `grade` after its mouth. Where it leaves, `main` should be nearly straight.
    """
    edge = float(main.half_width(np.array([s_m]))[0])
    here = main.line.at(np.array([s_m]))
    x, y = main.line.plan(np.array([s_m]), np.array([side * (edge - OVERLAP_M)]))[0]
    z = float(main.height(np.array([s_m]), np.array([side * edge]))[0]) + 0.02
    curvature = bend_rad / 18.0
    line = alignment(
        [(0.0, 0.0), (12.0, 0.0), (18.0, curvature), (30.0, curvature), (36.0, 0.0), (length_m, 0.0)],
        [(0.0, z), (MOUTH_BLEND_M, z), (length_m, z + grade * (length_m - MOUTH_BLEND_M))],
        start=(float(x), float(y), float(here.heading_rad[0]) + side * math.pi / 2),
    )
    road = Road(line, section, joins=main)
    half_gap = section.half_width_m + road.mouth_radius_m
    return main.opened(Opening(s_m - half_gap, s_m + half_gap, side)), road
