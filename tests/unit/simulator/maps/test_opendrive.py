from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from itertools import pairwise
from pathlib import Path

import numpy as np
import pymap3d
import pytest

from contract.geometry import LatLon
from simulator.maps.opendrive import LaneKey, OpenDriveLane, OpenDriveMap, read_opendrive
from simulator.maps.opendrive_xml import OpenDriveError

GRADE, ROLL_RAD, CURVATURE = 0.05, 0.03, 0.05
TMERC = "+proj=tmerc +lat_0=38.2 +lon_0=21.7 +k=1 +x_0=0 +y_0=0 +datum=WGS84 +units=m +no_defs"


def lane(number: int, kind: str, width: str, mark: str = "", link: str = "") -> str:
    return (
        f'<lane id="{number}" type="{kind}" level="false"><link>{link}</link><width sOffset="0" {width}/>{mark}</lane>'
    )


def flat(value: float) -> str:
    return f'a="{value}" b="0" c="0" d="0"'


def mark(kind: str, offset: float = 0, colour: str = "white") -> str:
    return f'<roadMark sOffset="{offset}" type="{kind}" weight="standard" color="{colour}" width="0.12"/>'


def road(number: int, length: float, plan: str, lanes: str, link: str = "", extra: str = "", junction: int = -1) -> str:
    return (
        f'<road name="" length="{length}" id="{number}" junction="{junction}"><link>{link}</link>'
        f"<planView>{plan}</planView>{extra}<lanes>{lanes}</lanes></road>"
    )


def geometry(s: float, x: float, y: float, heading: float, length: float, shape: str = "<line/>") -> str:
    return f'<geometry s="{s}" x="{x!r}" y="{y!r}" hdg="{heading!r}" length="{length}">{shape}</geometry>'


def section(left: str, right: str, s: float = 0, middle: str = "") -> str:
    centre = f'<center><lane id="0" type="none" level="false">{middle}</lane></center>'
    return f'<laneSection s="{s}"><left>{left}</left>{centre}<right>{right}</right></laneSection>'


def along(s: np.ndarray | float) -> np.ndarray:
    """The first road's reference line: 30 m straight, then an arc to the left; x, y and heading."""
    bend = np.maximum(np.asarray(s, dtype=float) - 30, 0)
    heading = CURVATURE * bend
    x = 10 + np.minimum(s, 30) + np.sin(heading) / CURVATURE
    return np.stack([x, 20 + (1 - np.cos(heading)) / CURVATURE, heading])


def town(shift: float = 0.0, reference: str = TMERC) -> str:
    """Straight and arc with grade and superelevation, two lane sections, a junction with two ways on."""
    x, y, heading = (float(value) for value in along(50.0))
    arc = f'<arc curvature="{CURVATURE}"/>'
    plan = geometry(0, 10 + shift, 20, 0.0, 30) + geometry(30, 40 + shift, 20, 0.0, 20, arc)
    profile = (
        f'<elevationProfile><elevation s="0" a="1" b="{GRADE}" c="0" d="0"/></elevationProfile>'
        f'<lateralProfile><superelevation s="0" {flat(ROLL_RAD)}/></lateralProfile>'
    )
    on = '<predecessor id="{0}"/><successor id="{0}"/>'
    lanes = section(
        lane(1, "driving", 'a="3.0" b="0.01" c="0" d="0"', mark("solid"), '<successor id="1"/>'),
        lane(-1, "driving", flat(3.5), mark("solid"), '<successor id="-1"/>')
        + lane(-2, "sidewalk", flat(1.5), "", '<successor id="-2"/>'),
        middle=mark("broken") + mark("solid", 10, "yellow"),
    ) + section(
        lane(1, "driving", flat(3.2), "", '<predecessor id="1"/>'),
        lane(-1, "driving", flat(3.5), "", '<predecessor id="-1"/>')
        + lane(-2, "sidewalk", flat(1.5), "", '<predecessor id="-2"/>')
        + lane(-3, "parking", flat(2.0)),
        s=20,
    )
    end = (x + 20 * math.cos(heading) + shift, y + 20 * math.sin(heading))
    bend = f'<arc curvature="{-CURVATURE}"/>'
    single = section("", lane(-1, "driving", flat(3.5)))
    linked = section("", lane(-1, "driving", flat(3.5), "", on.format(-1)))
    ahead = '<predecessor elementType="road" elementId="1" contactPoint="end"/>'
    roads = [
        road(1, 50, plan, lanes, '<successor elementType="junction" elementId="100"/>', profile),
        road(
            10,
            20,
            geometry(0, x + shift, y, heading, 20),
            linked,
            ahead + '<successor elementType="road" elementId="2" contactPoint="start"/>',
            junction=100,
        ),
        road(
            11,
            10,
            geometry(0, x + shift, y, heading, 10, bend),
            section("", lane(-1, "driving", flat(3.5), "", '<predecessor id="-1"/>')),
            ahead,
            junction=100,
        ),
        road(2, 20, geometry(0, *end, heading, 20), single, '<predecessor elementType="junction" elementId="100"/>'),
    ]
    connections = "".join(
        f'<connection id="{i}" incomingRoad="1" connectingRoad="{n}" contactPoint="start">'
        '<laneLink from="-1" to="-1"/></connection>'
        for i, n in enumerate((10, 11))
    )
    return (
        '<?xml version="1.0"?><OpenDRIVE><header revMajor="1" revMinor="4" name="town">'
        f"<geoReference><![CDATA[{reference}]]></geoReference></header>{''.join(roads)}"
        f'<junction id="100" name="">{connections}</junction></OpenDRIVE>'
    )


def written(folder: Path, text: str) -> Path:
    path = folder / "town.xodr"
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def read(tmp_path_factory: pytest.TempPathFactory) -> OpenDriveMap:
    return read_opendrive(written(tmp_path_factory.mktemp("xodr"), town()))


def lane_of(read: OpenDriveMap, *key: int) -> OpenDriveLane:
    return next(found for r in read.roads for found in r.lanes if found.key == LaneKey(*key))


def expected(lane: OpenDriveLane, middle_m: tuple[float, float], offset_m: np.ndarray) -> np.ndarray:
    """Points of the first road left of its reference line, from the standard's formulas."""
    x, y, heading = along(lane.s_m)
    flat_offset, z = offset_m * math.cos(ROLL_RAD), 1 + GRADE * lane.s_m + offset_m * math.sin(ROLL_RAD)
    x, y = x - flat_offset * np.sin(heading), y + flat_offset * np.cos(heading)
    return np.stack([x - middle_m[0], y - middle_m[1], z], axis=1)


def test_every_road_is_there_with_its_lanes_from_left_to_right(read: OpenDriveMap) -> None:
    assert [(r.road_id, r.junction_id, [k.key[1:] for k in r.lanes]) for r in read.roads] == [
        (1, -1, [(0, 1), (0, -1), (0, -2), (1, 1), (1, -1), (1, -2), (1, -3)]),
        (10, 100, [(0, -1)]),
        (11, 100, [(0, -1)]),
        (2, -1, [(0, -1)]),
    ]
    kinds = [found.kind for found in read.roads[0].lanes]
    assert kinds == ["driving", "driving", "sidewalk", "driving", "driving", "sidewalk", "parking"]


def test_lanes_of_a_section_share_their_places_along_the_road_a_metre_apart(read: OpenDriveMap) -> None:
    for number, start, end in ((0, 0, 20), (1, 20, 50)):
        lanes = [found for found in read.roads[0].lanes if found.key.section == number]
        for found in lanes:
            assert found.s_m.tolist() == lanes[0].s_m.tolist()
            assert np.diff(found.s_m).max() <= 1.0
        assert (lanes[0].s_m[0], lanes[0].s_m[-1]) == pytest.approx((start, end), abs=0.002)


@pytest.mark.parametrize(
    ("key", "offset"),
    [((1, 0, 1), 1.5), ((1, 0, -1), -1.75), ((1, 0, -2), -4.25), ((1, 1, -1), -1.75), ((1, 1, -3), -6.0)],
)
def test_centres_follow_line_arc_grade_and_superelevation(
    read: OpenDriveMap, key: tuple[int, int, int], offset: float
) -> None:
    found = lane_of(read, *key)
    widening = 0.005 * found.s_m if key == (1, 0, 1) else 0.0
    assert found.centre_m == pytest.approx(expected(found, read.middle_m, offset + widening), abs=2e-4)
    assert found.heading_rad == pytest.approx(along(found.s_m)[2], abs=1e-4)


def test_neighbouring_lanes_meet_at_their_edges(read: OpenDriveMap) -> None:
    for number in (0, 1):
        lanes = [found for found in read.roads[0].lanes if found.key.section == number]
        for left, right in pairwise(lanes):
            assert left.right_m == pytest.approx(right.left_m, abs=2e-4)


def test_the_road_falls_to_the_right_where_superelevation_is_positive(read: OpenDriveMap) -> None:
    found = lane_of(read, 1, 0, -1)
    assert found.left_m[:, 2] - found.right_m[:, 2] == pytest.approx(3.5 * math.sin(ROLL_RAD), abs=1e-9)


def test_marks_lie_left_and_right_of_somebody_who_looks_along_the_road(read: OpenDriveMap) -> None:
    right, left = lane_of(read, 1, 0, -1), lane_of(read, 1, 0, 1)
    assert [(m.kind, m.colour, m.width_m) for m in right.left_marks] == [
        ("broken", "white", 0.12),
        ("solid", "yellow", 0.12),
    ]
    assert right.left_marks[0].to_m == pytest.approx(10, abs=1.0)
    assert left.right_marks == right.left_marks
    assert [m.kind for m in left.left_marks] == [m.kind for m in right.right_marks] == ["solid"]
    assert lane_of(read, 1, 1, -3).right_marks == ()


def test_successors_lead_on_in_the_direction_of_travel(read: OpenDriveMap) -> None:
    assert lane_of(read, 1, 0, -1).successors == (LaneKey(1, 1, -1),)
    assert lane_of(read, 1, 1, -1).successors == (LaneKey(10, 0, -1), LaneKey(11, 0, -1))
    assert lane_of(read, 10, 0, -1).successors == (LaneKey(2, 0, -1),)
    assert lane_of(read, 1, 1, 1).successors == (LaneKey(1, 0, 1),)
    assert lane_of(read, 1, 0, 1).successors == lane_of(read, 2, 0, -1).successors == ()
    assert not lane_of(read, 1, 0, 1).travels_along_s
    assert lane_of(read, 1, 0, -1).travels_along_s


def test_a_lane_begins_where_the_one_before_it_ended(read: OpenDriveMap) -> None:
    for one, other in (((1, 0, -1), (1, 1, -1)), ((10, 0, -1), (2, 0, -1))):
        gap = lane_of(read, *other).centre_m[0] - lane_of(read, *one).centre_m[-1]
        assert np.linalg.norm(gap) < 0.003


def test_where_traffic_keeps_left_the_left_lane_goes_along(tmp_path: Path) -> None:
    text = town().replace('junction="-1">', 'junction="-1" rule="LHT">')
    there = read_opendrive(written(tmp_path, text))
    assert lane_of(there, 1, 0, 1).travels_along_s
    assert not lane_of(there, 1, 0, -1).travels_along_s
    assert lane_of(there, 1, 0, -1).heading_rad == pytest.approx(0.0, abs=1e-4)
    assert [m.kind for m in lane_of(there, 1, 0, 1).left_marks] == ["solid"]


def test_the_maps_middle_is_the_origin_and_lies_where_its_georeference_says(read: OpenDriveMap) -> None:
    centres = np.concatenate([found.centre_m for r in read.roads for found in r.lanes])
    assert np.abs(centres[:, :2]).max() < 45
    place = read.place.position
    east, north, _ = pymap3d.geodetic2enu(place.latitude_deg, place.longitude_deg, 0, 38.2, 21.7, 0)
    assert (east, north) == pytest.approx(read.middle_m, abs=1e-3)
    assert abs(read.place.yaw_rad) < 1e-4


def test_far_from_the_origin_nothing_is_lost_to_float32(tmp_path: Path, read: OpenDriveMap) -> None:
    far = read_opendrive(written(tmp_path, town(shift=4_000_000.0)), origin=LatLon(latitude_deg=0, longitude_deg=0))
    one, other = lane_of(far, 1, 0, -1), lane_of(read, 1, 0, -1)
    assert one.centre_m == pytest.approx(other.centre_m, abs=1e-3)


@pytest.mark.parametrize("reference", ["", "EPSG:25832", "+proj=utm +zone=32 +datum=WGS84", "+proj=tmerc +lat_0=x"])
def test_a_georeference_that_cannot_be_read_is_asked_for(tmp_path: Path, reference: str) -> None:
    path = written(tmp_path, town(reference=reference))
    with pytest.raises(OpenDriveError, match="--origin"):
        read_opendrive(path)
    stated = read_opendrive(path, origin=LatLon(latitude_deg=38.2, longitude_deg=21.7))
    assert stated.place.position.latitude_deg == pytest.approx(38.2, abs=0.001)


def test_carlas_default_place_is_never_taken(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = written(tmp_path, town(reference="garbage"))
    read_opendrive(path, origin=LatLon(latitude_deg=38.2, longitude_deg=21.7))
    path.write_text(re.sub("<header.*</header>", "", town()))
    read_opendrive(path, origin=LatLon(latitude_deg=38.2, longitude_deg=21.7))
    assert "WARNING" not in "".join(capfd.readouterr())


BROKEN = {
    "not XML": ("roads", "which is XML"),
    "another XML": ("<svg/>", "first element is OpenDRIVE"),
    "no roads": ("<OpenDRIVE/>", "no roads"),
    "entities": ('<!DOCTYPE a [<!ENTITY b "c">]><OpenDRIVE>&b;</OpenDRIVE>', "document type"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_what_is_no_map_is_refused(tmp_path: Path, name: str) -> None:
    text, message = BROKEN[name]
    with pytest.raises(OpenDriveError, match=message):
        read_opendrive(written(tmp_path, text))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<planView>", "<other>", "which is XML"),
        (f'<arc curvature="{CURVATURE}"/>', "<clothoid/>", "each geometry needs one of line, arc"),
        ('length="30"', 'length="nan"', "length of a geometry is not a number"),
        ('s="30"', 's="35"', "a gap or an overlap at s = 30"),
        ('id="10" junction', 'id="1" junction', "two roads have the same id"),
        ('connectingRoad="10"', 'connectingRoad="77"', "lacks its incoming or its connecting road"),
        ('from="-1"', 'from="-9"', "lanes that are not there"),
        ('<successor id="-2"/>', '<successor id="-7"/>', "successor -7 is not there"),
        ('lane id="-2"', 'lane id="-5"', "right lanes are not numbered"),
        ('lane id="0"', 'lane id="4"', "no center lane 0"),
        ('elementId="2"', 'elementId="66"', "successor road 66 is not there"),
        ('junction="100"', 'junction="300"', "junction 300 is not there"),
        ('<width sOffset="0" a="2.0"', '<width sOffset="1" a="2.0"', "no width at the start"),
        ('<laneSection s="20">', '<laneSection s="0">', "do not rise from s = 0"),
    ],
)
def test_a_map_that_would_end_carlas_reader_is_refused_in_words(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert old in town()
    with pytest.raises(OpenDriveError, match=message):
        read_opendrive(written(tmp_path, town().replace(old, new)))


def test_missing_and_huge_files_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(OpenDriveError, match="cannot be read"):
        read_opendrive(tmp_path / "absent.xodr")
    monkeypatch.setattr("simulator.maps.opendrive_xml.MOST_BYTES", 1_000)
    with pytest.raises(OpenDriveError, match="cut the map"):
        read_opendrive(written(tmp_path, town()))


@pytest.mark.parametrize("step_m", [0.0, -1.0, math.nan, 1e6])
def test_a_step_that_makes_no_sense_is_refused(tmp_path: Path, step_m: float) -> None:
    with pytest.raises(OpenDriveError, match="step"):
        read_opendrive(written(tmp_path, town()), step_m=step_m)


def test_damaged_maps_give_roads_or_a_clear_error(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    outcomes = set()
    for _ in range(150):
        root = ET.fromstring(town())  # noqa: S314  # our own text
        for _ in range(rng.integers(1, 3)):
            pairs = [(parent, child) for parent in root.iter() for child in parent]
            parent, child = pairs[rng.integers(len(pairs))]
            if rng.random() < 0.4 or not child.attrib:
                parent.remove(child)
            else:
                name = str(rng.choice(sorted(child.attrib)))
                child.set(name, str(rng.choice(["nan", "-1", "1e30", "999", "abc", "0", "inf", ""])))
        try:
            read_opendrive(written(tmp_path, ET.tostring(root, encoding="unicode")), step_m=5.0)
            outcomes.add("read")
        except OpenDriveError:
            outcomes.add("refused")
    assert outcomes == {"read", "refused"}
