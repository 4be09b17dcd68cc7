"""An OpenDRIVE file checked before CARLA's reader sees it, which ends the program where an element is missing."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pymap3d
from numpy.typing import NDArray

from contract.geometry import LatLon
from simulator.maps.opendrive_links import broken_links

FloatArray = NDArray[np.float64]

MOST_BYTES = 64_000_000
"""CARLA's largest maps have about 30 MB."""

LONGEST_ROAD_M = 100_000.0

LARGEST = 1e9
"""Coordinates of projections that cover the earth stay below; CARLA's reader takes any number."""

GAP_M = 0.5
"""Real maps round the lengths of their geometries; larger gaps mean that one is missing."""

SHAPES = ("line", "arc", "spiral", "poly3", "paramPoly3")

LARGEST_M = {"width": 100.0, "laneOffset": 1_000.0, "elevation": 9_000.0}
"""Metres that the constant term of a profile may have: lanes of an airfield, and the highest mountains."""

NUMBERS = {
    "road": ("length",),
    "geometry": ("s", "x", "y", "hdg", "length"),
    "arc": ("curvature",),
    "spiral": ("curvStart", "curvEnd"),
    "poly3": ("a", "b", "c", "d"),
    "paramPoly3": ("aU", "bU", "cU", "dU", "aV", "bV", "cV", "dV"),
    "elevation": ("s", "a", "b", "c", "d"),
    "superelevation": ("s", "a", "b", "c", "d"),
    "laneOffset": ("s", "a", "b", "c", "d"),
    "laneSection": ("s",),
    "width": ("sOffset", "a", "b", "c", "d"),
}
"""Attributes that must be finite numbers, by element."""


class OpenDriveError(ValueError):
    """A map cannot be used; the message says why and what to do."""


@dataclass(frozen=True, slots=True)
class MapPlace:
    """Where the middle of a map lies: the place, and the direction of the map's x counter-clockwise from east."""

    position: LatLon
    altitude_m: float
    yaw_rad: float


def read_checked(path: Path) -> ET.Element:
    """The root of an OpenDRIVE file all of whose roads have what CARLA's reader needs."""
    try:
        if path.stat().st_size > MOST_BYTES:
            raise OpenDriveError(f"{path}: more than {MOST_BYTES // 1_000_000} MB; cut the map to the part to drive in")
        data = path.read_bytes()
    except OSError as error:
        raise OpenDriveError(f"{path}: cannot be read: {error.strerror}") from error
    root = _parse(path, data)
    if root.tag != "OpenDRIVE":
        raise OpenDriveError(f"{path}: expected an OpenDRIVE file, whose first element is OpenDRIVE")
    roads = root.findall("road")
    if not roads:
        raise OpenDriveError(f"{path}: holds no roads")
    numbers = [road.get("id") for road in roads]
    if len(set(numbers)) < len(numbers):
        raise OpenDriveError(f"{path}: two roads have the same id")
    for road in roads:
        for problem in _problems(road):
            raise OpenDriveError(f"{path}: road {road.get('id')}: {problem}")
    for problem in broken_links(root):
        raise OpenDriveError(f"{path}: {problem}")
    return root


def polynomial(records: list[ET.Element], s_m: FloatArray) -> FloatArray:
    """Value at (K,) of cubics a + b ds + c ds^2 + d ds^3, each from its own s on; 0 before the first."""
    value = np.zeros_like(s_m)
    for record in sorted(records, key=lambda element: float(element.attrib["s"])):
        start, *factors = (float(record.attrib[name]) for name in ("s", "a", "b", "c", "d"))
        beyond = s_m >= start
        value[beyond] = np.polynomial.polynomial.polyval(s_m[beyond] - start, factors)
    return value


def recentred(root: ET.Element) -> tuple[float, float]:
    """Move the map's middle to the origin, in whole metres, and say where it was: CARLA computes in float32."""
    geometries = list(root.iterfind("road/planView/geometry"))
    middle = []
    for axis in ("x", "y"):
        values = [float(geometry.attrib[axis]) for geometry in geometries]
        middle.append(float(round((min(values) + max(values)) / 2)))
        for geometry, value in zip(geometries, values, strict=True):
            geometry.set(axis, repr(value - middle[-1]))
    return middle[0], middle[1]


def map_place(path: Path, root: ET.Element, middle_m: tuple[float, float], origin: LatLon | None) -> MapPlace:
    """Where the middle of a map lies on earth.

    The map's coordinates are metres about `+lat_0`, `+lon_0` of its `<geoReference>` (a transverse Mercator map: the
    scale and the meridians' convergence over a town are neglected), or about `origin`. `OpenDriveError` for another
    projection: CARLA would take it for latitude 42, longitude 2.
    """
    reference = root.findtext("header/geoReference") or ""
    x_m, y_m = middle_m
    if origin is None:
        terms = dict(re.findall(r"\+(\w+)=(\S+)", reference))
        try:
            origin = LatLon(latitude_deg=float(terms["lat_0"]), longitude_deg=float(terms["lon_0"]))
            x_m, y_m = x_m - float(terms.get("x_0", 0)), y_m - float(terms.get("y_0", 0))
        except (KeyError, ValueError):
            terms["proj"] = "unknown"
        if terms.get("proj", "tmerc") != "tmerc" or origin is None:
            raise OpenDriveError(
                f"{path}: its geoReference {reference.strip()[:80]!r} is not a transverse Mercator map with lat_0 and "
                "lon_0; state where its origin lies with --origin LATITUDE,LONGITUDE"
            )
    here = _geodetic(origin, x_m, y_m)
    ahead = _geodetic(origin, x_m + 100.0, y_m)
    east, north, _ = pymap3d.geodetic2enu(
        ahead.latitude_deg, ahead.longitude_deg, 0.0, here.latitude_deg, here.longitude_deg, 0.0
    )
    return MapPlace(here, 0.0, math.atan2(float(north), float(east)))


def _geodetic(origin: LatLon, x_m: float, y_m: float) -> LatLon:
    latitude, longitude, _ = pymap3d.enu2geodetic(x_m, y_m, 0.0, origin.latitude_deg, origin.longitude_deg, 0.0)
    return LatLon(latitude_deg=float(latitude), longitude_deg=float(longitude))


def _parse(path: Path, data: bytes) -> ET.Element:
    """The root element; declarations of entities, which can blow a file up, are refused unread."""
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    if re.search(r"<!\s*(DOCTYPE|ENTITY)", text, re.IGNORECASE):
        raise OpenDriveError(f"{path}: declares a document type, which no OpenDRIVE file needs")
    try:
        return ET.fromstring(text)  # noqa: S314  # no entities: see above
    except ET.ParseError as error:
        raise OpenDriveError(f"{path}: expected an OpenDRIVE file, which is XML: {error}") from error


def _problems(road: ET.Element) -> Iterator[str]:
    """What CARLA's reader would stumble over, in words."""
    if not _is_whole(road.get("id")):
        yield "its id is not a whole number"
    for element in road.iter():
        for name in NUMBERS.get(element.tag, ()):
            if not abs(_number(element.get(name))) < LARGEST:
                yield f"{name} of a {element.tag} is not a number of a map's size"
        if element.tag in LARGEST_M and not abs(_number(element.get("a"))) <= LARGEST_M[element.tag]:
            yield f"a of a {element.tag} is more than {LARGEST_M[element.tag]:g} m"
    if not 0 < _number(road.get("length")) <= LONGEST_ROAD_M:
        yield f"its length is not between 0 and {LONGEST_ROAD_M:.0f} m"
    geometries = road.findall("planView/geometry")
    if not geometries:
        yield "it has no planView geometry"
    end = 0.0
    for geometry in geometries:
        if abs(_number(geometry.get("s")) - end) > (GAP_M if end else 0.0):
            yield f"its planView has a gap or an overlap at s = {end:.2f} m"
        end = _number(geometry.get("s")) + _number(geometry.get("length"))
        if len(geometry) != 1 or geometry[0].tag not in SHAPES:
            yield f"each geometry needs one of {', '.join(SHAPES)}"
    if abs(end - _number(road.get("length"))) > GAP_M:
        yield f"its planView ends at {end:.2f} m, its length is {road.get('length')} m"
    sections = road.findall("lanes/laneSection")
    if not sections:
        yield "it has no laneSection"
    starts = [_number(section.get("s")) for section in sections]
    if starts and (starts != sorted(set(starts)) or starts[0] > 0 or starts[-1] >= _number(road.get("length"))):
        yield "its laneSections do not rise from s = 0 to less than its length"
    for section in sections:
        yield from _section_problems(section)


def _section_problems(section: ET.Element) -> Iterator[str]:
    if [lane.get("id") for lane in section.findall("center/lane")] != ["0"]:
        yield "a laneSection has no center lane 0, or several"
    for side, sign in (("left", 1), ("right", -1)):
        lanes = section.findall(f"{side}/lane")
        numbers = sorted(sign * int(_number(lane.get("id"))) for lane in lanes if _is_whole(lane.get("id")))
        if numbers != list(range(1, len(lanes) + 1)):
            yield f"the {side} lanes are not numbered {sign}, {2 * sign}, ..."
        for lane in lanes:
            if not any(_number(width.get("sOffset")) <= 0 for width in lane.findall("width")):
                yield f"lane {lane.get('id')} has no width at the start of its section"


def _is_whole(text: str | None) -> bool:
    return re.fullmatch(r"[+-]?\d{1,9}", text or "") is not None


def _number(text: str | None) -> float:
    try:
        return float(text or "nan")
    except ValueError:
        return math.nan
