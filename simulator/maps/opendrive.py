"""Roads and lanes of an OpenDRIVE map (`.xodr`), sampled into the street frame by CARLA's own reader.

CARLA's waypoints are left-handed and know no superelevation: both are seen to here. Needs the `carla` package, but no
simulator.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from itertools import groupby, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from contract.geometry import LatLon
from simulator.maps.opendrive_xml import MapPlace, OpenDriveError, map_place, polynomial, read_checked, recentred

if TYPE_CHECKING:
    import carla

FloatArray = NDArray[np.float64]

END_M = 1e-3
"""Samples stay this far from the ends of a section: at the end itself CARLA finds no lane."""


class LaneKey(NamedTuple):
    """A lane: its road, the number of the lane section from the road's start, and its id (negative to the right)."""

    road_id: int
    section: int
    lane_id: int


@dataclass(frozen=True, slots=True)
class LaneMark:
    """A painted line along an edge from one s to another; kinds and colours as in OpenDRIVE: `solid`, `white`."""

    from_m: float
    to_m: float
    kind: str
    colour: str
    width_m: float


@dataclass(frozen=True, slots=True)
class OpenDriveLane:
    """A lane of one lane section, sampled at K places along the road's s.

    `centre_m` (K, 3), frame `street`; `heading_rad` (K,) of the road's reference direction, counter-clockwise from x,
    towards growing s for all lanes; `superelevation_rad` (K,), positive where the road falls to the right;
    `width_m` (K,) across; `s_m` (K,). Left and right are those of somebody who looks towards growing s. `successors`
    are where traffic can go on, in the direction of travel. `kind` is OpenDRIVE's type in lower case: driving,
    shoulder, sidewalk, parking, median, ...
    """

    key: LaneKey
    kind: str
    centre_m: FloatArray
    heading_rad: FloatArray
    superelevation_rad: FloatArray
    width_m: FloatArray
    s_m: FloatArray
    left_marks: tuple[LaneMark, ...]
    right_marks: tuple[LaneMark, ...]
    successors: tuple[LaneKey, ...]
    travels_along_s: bool

    @property
    def left_m(self) -> FloatArray:
        """Left edge (K, 3)."""
        return self.centre_m + self._across() * self.width_m[:, None] / 2

    @property
    def right_m(self) -> FloatArray:
        """Right edge (K, 3)."""
        return self.centre_m - self._across() * self.width_m[:, None] / 2

    def _across(self) -> FloatArray:
        return _left_of(self.heading_rad, self.superelevation_rad)


@dataclass(frozen=True, slots=True)
class OpenDriveRoad:
    """A road, or with a `junction_id` that is not -1 a connection through a junction; lanes from left to right."""

    road_id: int
    junction_id: int
    lanes: tuple[OpenDriveLane, ...]


@dataclass(frozen=True, slots=True)
class OpenDriveMap:
    """All roads of a map in the frame `street`, whose origin is the map's middle (`middle_m` in its coordinates)."""

    roads: tuple[OpenDriveRoad, ...]
    place: MapPlace
    middle_m: tuple[float, float]


def read_opendrive(path: Path, origin: LatLon | None = None, step_m: float = 1.0) -> OpenDriveMap:
    """The roads of an OpenDRIVE file, sampled every `step_m` or less.

    `origin` is where the map's own origin lies (x east, y north), instead of what its `<geoReference>` says. Lane
    heights, crossfall and lateral shapes are left out: the road's section is flat but for superelevation.
    `OpenDriveError` says what is wrong with a file.
    """
    if not 0.05 <= step_m <= 100:
        raise OpenDriveError(f"a step of {step_m} m is not between 0.05 and 100 m")
    root = read_checked(path)
    middle_m = recentred(root)
    place = map_place(path, root, middle_m, origin)
    try:
        carla_map = _carla_map(path, root)
        roads = tuple(_road(carla_map, element, step_m) for element in root.iterfind("road"))
    except (RuntimeError, IndexError) as error:  # what CARLA's C++ throws
        raise OpenDriveError(f"{path}: CARLA's reader of OpenDRIVE refuses it: {error}") from error
    return OpenDriveMap(roads, place, middle_m)


def _carla_map(path: Path, root: ET.Element) -> carla.Map:
    try:
        import carla
    except ImportError as error:
        raise OpenDriveError("OpenDRIVE maps are read with carla; run pip install 'headsup[carla]'") from error
    header = root.find("header")
    header = ET.SubElement(root, "header") if header is None else header
    reference = header.find("geoReference")
    reference = ET.SubElement(header, "geoReference") if reference is None else reference
    reference.text = "+lat_0=0 +lon_0=0"  # CARLA prints a warning about what it cannot read, and we have read it
    return carla.Map(path.stem, ET.tostring(root, encoding="unicode"))


def _road(carla_map: carla.Map, road: ET.Element, step_m: float) -> OpenDriveRoad:
    sections = road.findall("lanes/laneSection")
    bounds = [*(float(section.attrib["s"]) for section in sections), float(road.attrib["length"])]
    lanes: list[OpenDriveLane] = []
    for number, (section, (start, end)) in enumerate(zip(sections, pairwise(bounds), strict=True)):
        count = max(2, math.ceil((end - start) / step_m) + 1)
        margin = min(END_M, (end - start) / 4)
        lanes += _section_lanes(carla_map, road, section, number, np.linspace(start + margin, end - margin, count))
    return OpenDriveRoad(int(road.attrib["id"]), int(road.get("junction", "-1")), tuple(lanes))


def _section_lanes(
    carla_map: carla.Map, road: ET.Element, section: ET.Element, number: int, s_m: FloatArray
) -> list[OpenDriveLane]:
    """The lanes of a section: those right of the reference line from the inside out, and so those left of it."""
    roll = polynomial(road.findall("lateralProfile/superelevation"), s_m)
    middle = polynomial(road.findall("lanes/laneOffset"), s_m)
    found: list[OpenDriveLane] = []
    for side, sign in (("left", 1), ("right", -1)):
        inner = middle.copy()
        count = len(section.findall(f"{side}/lane"))
        for lane_id in range(sign, sign * (count + 1), sign):
            key = LaneKey(int(road.attrib["id"]), number, lane_id)
            waypoints = [_waypoint(carla_map, key, s) for s in s_m.tolist()]
            width = np.array([waypoint.lane_width for waypoint in waypoints])
            offset = inner + sign * width / 2
            found.append(_lane(key, waypoints, s_m, width, offset, roll, road.get("rule") == "LHT"))
            inner += sign * width
    return sorted(found, key=lambda lane: -lane.key.lane_id)


def _lane(
    key: LaneKey,
    waypoints: list[carla.Waypoint],
    s_m: FloatArray,
    width_m: FloatArray,
    offset_m: FloatArray,
    roll_rad: FloatArray,
    drives_on_left: bool,
) -> OpenDriveLane:
    """A lane from CARLA's waypoints and its distance `offset_m` (K,) left of the reference line."""
    along_s = (key.lane_id > 0) == drives_on_left
    flat = np.array([(w.transform.location.x, -w.transform.location.y, w.transform.location.z) for w in waypoints])
    yaw = np.array([-math.radians(w.transform.rotation.yaw) for w in waypoints])
    # CARLA's waypoints look where traffic goes, turned by the angle at which the lane leaves the reference line.
    heading = np.unwrap(yaw + (0.0 if along_s else math.pi) - np.arctan(np.gradient(offset_m, s_m)))
    level = _left_of(heading, np.zeros_like(heading))
    centre = flat + offset_m[:, None] * (_left_of(heading, roll_rad) - level)
    left, right = [w.left_lane_marking for w in waypoints], [w.right_lane_marking for w in waypoints]
    if not along_s:
        left, right = right, left
    end = waypoints[-1 if along_s else 0]
    return OpenDriveLane(
        key=key,
        kind=str(waypoints[0].lane_type).lower(),
        centre_m=centre,
        heading_rad=heading,
        superelevation_rad=roll_rad,
        width_m=width_m,
        s_m=s_m,
        left_marks=_marks(left, s_m),
        right_marks=_marks(right, s_m),
        successors=tuple(sorted({LaneKey(w.road_id, w.section_id, w.lane_id) for w in end.next(3 * END_M)} - {key})),
        travels_along_s=along_s,
    )


def _waypoint(carla_map: carla.Map, key: LaneKey, s_m: float) -> carla.Waypoint:
    waypoint = carla_map.get_waypoint_xodr(key.road_id, key.lane_id, s_m)
    if waypoint is None:
        raise OpenDriveError(f"road {key.road_id}: CARLA finds no lane {key.lane_id} at s = {s_m:.2f} m")
    return waypoint


def _marks(markings: list[carla.LaneMarking | None], s_m: FloatArray) -> tuple[LaneMark, ...]:
    """Runs of the same painted line; none where nothing is painted."""
    described = [
        None if m is None else (str(m.type).lower(), str(m.color).lower(), round(m.width, 4)) for m in markings
    ]
    marks = []
    for what, run in groupby(range(len(described)), key=lambda index: described[index]):
        indices = list(run)
        if what is not None and what[0] != "none":
            after = min(indices[-1] + 1, len(s_m) - 1)
            marks.append(LaneMark(float(s_m[indices[0]]), float(s_m[after]), *what))
    return tuple(marks)


def _left_of(heading_rad: FloatArray, roll_rad: FloatArray) -> FloatArray:
    """Unit vectors (K, 3) across the road, to the left: up where the road falls to the right."""
    level = np.cos(roll_rad)
    return np.stack([-np.sin(heading_rad) * level, np.cos(heading_rad) * level, np.sin(roll_rad)], axis=1)
