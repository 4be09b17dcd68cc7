"""Footprints of boxes in the plane, by shapely: overlap about a common centre, and of boxes apart."""

from __future__ import annotations

import math

import shapely
from shapely.affinity import rotate, translate

from contract.geometry import Box
from server.geodesy import EastNorth


def footprint_mm(box: Box) -> shapely.Polygon:
    """The box about the origin in millimetres, x east, y north."""
    upright = shapely.box(-box.length_mm / 2, -box.width_mm / 2, box.length_mm / 2, box.width_mm / 2)
    return rotate(upright, box.yaw_rad, origin=(0, 0), use_radians=True)


def union_over_intersection(a: Box, b: Box, *, ignore_yaw: bool) -> float:
    """Inverse of the intersection over union of two boxes about a common centre; 1 for equal boxes."""
    if ignore_yaw:
        a, b = (box.model_copy(update={"yaw_rad": 0.0}) for box in (a, b))
    intersection = footprint_mm(a).intersection(footprint_mm(b)).area
    return (a.length_mm * a.width_mm + b.length_mm * b.width_mm - intersection) / intersection


def overlap_of_smaller(a: Box, b: Box, a_from_b_m: EastNorth) -> float:
    """Share of the smaller box that lies in the other; `a_from_b_m` is a's centre minus b's."""
    moved = translate(footprint_mm(a), 1000 * a_from_b_m.east_m, 1000 * a_from_b_m.north_m)
    smaller_mm2 = min(a.length_mm * a.width_mm, b.length_mm * b.width_mm)
    return float(moved.intersection(footprint_mm(b)).area) / smaller_mm2


def turn_rad(a: Box, b: Box) -> float:
    """Smallest angle between the directions of two boxes, in [0, pi / 2]."""
    apart = abs(a.yaw_rad - b.yaw_rad) % math.pi
    return min(apart, math.pi - apart)


def elongation(box: Box) -> float:
    """Length over width, at least 1."""
    return box.length_mm / box.width_mm
