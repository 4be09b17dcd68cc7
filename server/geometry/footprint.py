"""Footprints of boxes in the plane: overlap about a common centre, and of boxes apart."""

from __future__ import annotations

import math
from itertools import pairwise

from contract.geometry import Box
from server.geometry.geodesy import EastNorth

Corners = list[tuple[float, float]]


def union_over_intersection(a: Box, b: Box, *, ignore_yaw: bool) -> float:
    """Inverse of the intersection over union of two boxes about a common centre; 1 for equal boxes."""
    turn_rad = 0.0 if ignore_yaw else a.yaw_rad - b.yaw_rad
    intersection_mm2 = _area_inside_mm2(_corners_mm(a, turn_rad, 0.0, 0.0), b)
    return (a.length_mm * a.width_mm + b.length_mm * b.width_mm - intersection_mm2) / intersection_mm2


def overlap_of_smaller(a: Box, b: Box, a_from_b_m: EastNorth) -> float:
    """Share of the smaller box that lies in the other; `a_from_b_m` is a's centre minus b's."""
    cosine, sine = math.cos(b.yaw_rad), math.sin(b.yaw_rad)
    along_mm = 1000 * (cosine * a_from_b_m.east_m + sine * a_from_b_m.north_m)
    across_mm = 1000 * (cosine * a_from_b_m.north_m - sine * a_from_b_m.east_m)
    smaller_mm2 = min(a.length_mm * a.width_mm, b.length_mm * b.width_mm)
    return _area_inside_mm2(_corners_mm(a, a.yaw_rad - b.yaw_rad, along_mm, across_mm), b) / smaller_mm2


def turn_rad(a: Box, b: Box) -> float:
    """Smallest angle between the directions of two boxes, in [0, pi / 2]."""
    apart = abs(a.yaw_rad - b.yaw_rad) % math.pi
    return min(apart, math.pi - apart)


def elongation(box: Box) -> float:
    """Length over width, at least 1."""
    return box.length_mm / box.width_mm


def _corners_mm(box: Box, yaw_rad: float, x_mm: float, y_mm: float) -> Corners:
    """Corners of a box with that direction and centre, counter-clockwise."""
    cosine, sine = math.cos(yaw_rad) / 2, math.sin(yaw_rad) / 2
    along_x, along_y = cosine * box.length_mm, sine * box.length_mm
    across_x, across_y = -sine * box.width_mm, cosine * box.width_mm
    return [
        (x_mm + along_x + across_x, y_mm + along_y + across_y),
        (x_mm - along_x + across_x, y_mm - along_y + across_y),
        (x_mm - along_x - across_x, y_mm - along_y - across_y),
        (x_mm + along_x - across_x, y_mm + along_y - across_y),
    ]


def _area_inside_mm2(corners: Corners, box: Box) -> float:
    """Area of a convex polygon inside a box that lies along the axes about the origin (Sutherland and Hodgman, 1974).

    By hand, since shapely takes ten times as long for two boxes, of which every report has some; a test holds this
    against it.
    """
    half_length_mm, half_width_mm = box.length_mm / 2, box.width_mm / 2
    inside = corners
    for x, y, limit_mm in (
        (1, 0, half_length_mm),
        (-1, 0, half_length_mm),
        (0, 1, half_width_mm),
        (0, -1, half_width_mm),
    ):
        if not inside:
            return 0.0
        inside = _clipped(inside, x, y, limit_mm)
    return sum(ax * by - bx * ay for (ax, ay), (bx, by) in pairwise([*inside, *inside[:1]])) / 2


def _clipped(corners: Corners, x: int, y: int, limit_mm: float) -> Corners:
    """What of a convex polygon lies within `limit_mm` of the origin along the direction (x, y)."""
    kept: Corners = []
    before = corners[-1]
    before_mm = x * before[0] + y * before[1] - limit_mm
    for corner in corners:
        beyond_mm = x * corner[0] + y * corner[1] - limit_mm
        if (beyond_mm > 0) != (before_mm > 0):
            part = before_mm / (before_mm - beyond_mm)
            kept.append((before[0] + part * (corner[0] - before[0]), before[1] + part * (corner[1] - before[1])))
        if beyond_mm <= 0:
            kept.append(corner)
        before, before_mm = corner, beyond_mm
    return kept
