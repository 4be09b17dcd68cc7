from __future__ import annotations

import math
import pickle
from itertools import pairwise
from pathlib import Path as FilePath

import numpy as np
import pytest

from contract.geometry import LatLon
from simulator.maps.map_roads import opened_where_they_meet, roads_of
from simulator.maps.map_routes import Lanes
from simulator.maps.map_street import Convoy, MapFile, crosses_itself, map_course
from simulator.maps.opendrive import OpenDriveLane, OpenDriveMap, read_opendrive
from simulator.maps.opendrive_xml import OpenDriveError
from simulator.mesh import pose
from simulator.motion import Standing
from simulator.scenario import Scenario, ScenarioPlan, scenario
from simulator.streets.course import BEHIND_M, Course, Stretch, last_start_m
from simulator.streets.keeping_clear import RoadSpace
from simulator.streets.placing import random_parked_cars
from simulator.streets.road import Road
from simulator.streets.street import ParkedCar, Street
from simulator.streets.trajectory import Path
from simulator.streets.world_plan import WorldPlan
from tests.unit.simulator.crossroads import EAST, EXAMPLE, NORTH, SOUTH, WEST, crossroads
from tests.unit.simulator.maps import test_opendrive as xodr
from tests.unit.simulator.maps.test_opendrive import town

pytest.importorskip("carla")

SEEDS = range(6)


@pytest.fixture(scope="module")
def crossing() -> OpenDriveMap:
    return read_opendrive(EXAMPLE)


@pytest.fixture(scope="module")
def roads(crossing: OpenDriveMap) -> list[Road]:
    return opened_where_they_meet([one for road in crossing.roads for one in roads_of(road)])


@pytest.fixture(scope="module")
def happening() -> Scenario:
    return scenario(ScenarioPlan(4, egos=2, seconds=20.0, map_file=MapFile.at(EXAMPLE)))


def convoy(seconds: float = 10.0, behind_m: float = 60.0) -> Convoy:
    return Convoy(2, behind_m, seconds, seconds + 1.0)


def driven_lanes(crossing: OpenDriveMap) -> list[OpenDriveLane]:
    return [lane for road in crossing.roads for lane in road.lanes if lane.kind == "driving"]


def road_of(roads: list[Road], crossing: OpenDriveMap, road_id: int) -> list[Road]:
    """The roads made of one road of the map, found by the lanes that they hold."""
    (there,) = (road for road in crossing.roads if road.road_id == road_id)
    middles = [lane.centre_m[len(lane.centre_m) // 2] for lane in there.lanes if lane.kind == "driving"]
    return [r for r in roads if not r.connecting and any(holds(r, middle[None, :2])[0] for middle in middles)]


def holds(road: Road, xy_m: np.ndarray) -> np.ndarray:
    return road.holds(*road.line.project(xy_m))


def test_the_example_is_what_its_script_writes() -> None:
    assert EXAMPLE.read_text() == crossroads()


def test_each_lane_section_becomes_a_road_and_all_lanes_lie_on_carriageways(
    crossing: OpenDriveMap, roads: list[Road]
) -> None:
    assert len(roads) == 4 + 1 + 12
    assert sum(road.connecting for road in roads) == 12
    for lane in driven_lanes(crossing):
        on = np.zeros(len(lane.centre_m), dtype=bool)
        for road in roads:
            on |= holds(road, lane.centre_m[:, :2])
        assert on.all(), lane.key


def test_heights_are_those_of_the_map(crossing: OpenDriveMap, roads: list[Road]) -> None:
    street = Street(1, roads=tuple(roads))
    for lane in driven_lanes(crossing):
        for points in (lane.centre_m, lane.left_m * 0.9 + lane.right_m * 0.1):
            height = street.sound_height(points[:, 0], points[:, 1])
            assert height == pytest.approx(points[:, 2], abs=0.01), lane.key


def test_a_curve_leans_by_the_maps_superelevation(crossing: OpenDriveMap, roads: list[Road]) -> None:
    (east,) = road_of(roads, crossing, EAST)
    assert east.cross_slope(np.array([130.0]), np.array([1.0])) == pytest.approx([math.tan(-0.035)], abs=1e-3)
    assert east.cross_slope(np.array([30.0]), np.array([1.0])) == pytest.approx([0.0], abs=1e-6)


def test_marks_are_painted_where_the_map_has_them(crossing: OpenDriveMap, roads: list[Road]) -> None:
    (west,) = road_of(roads, crossing, WEST)
    (yellow,) = (line for line in west.lines() if line.colour == "yellow")
    assert not yellow.dashed
    assert yellow.offset_m[:, 1] == pytest.approx(np.zeros(len(yellow.offset_m)), abs=1e-3)
    assert (yellow.from_m, yellow.to_m) == (west.line.start_m, west.line.end_m)
    edges = sorted(float(line.offset_m[0, 1]) for line in west.lines() if line is not yellow)
    assert edges == pytest.approx([-3.5 + 0.16, 3.5 - 0.16], abs=0.01)
    (north,) = road_of(roads, crossing, NORTH)
    assert [line.dashed for line in north.lines()].count(True) == 1
    assert all(not road.lines() for road in roads if road.connecting)


def test_a_parking_lane_widens_the_road_and_its_lanes_stay_where_they_are(
    crossing: OpenDriveMap, roads: list[Road]
) -> None:
    near, far = sorted(road_of(roads, crossing, SOUTH), key=lambda road: float(road.half_width(np.array([5.0]))[0]))
    s = np.array([20.0])
    assert 2 * near.half_width(s) == pytest.approx([7.0], abs=1e-3)
    assert 2 * far.half_width(s) == pytest.approx([9.2], abs=1e-3)
    # Right of the old middle there are 5.7 m, left of it 3.5: the new middle lies 1.1 m to the right.
    assert sorted(far.lane_offsets(s)[:, 0]) == pytest.approx([-1.75 + 1.1, 1.75 + 1.1], abs=0.01)


def test_cars_park_in_parking_lanes_and_face_the_way_traffic_goes(crossing: OpenDriveMap, roads: list[Road]) -> None:
    near, far = sorted(road_of(roads, crossing, SOUTH), key=lambda road: float(road.half_width(np.array([5.0]))[0]))
    assert far.has_parking(-1)
    assert not far.has_parking(1)
    assert not near.has_parking(-1)
    rng, stretch = np.random.default_rng(1), Stretch(far, 0.0, far.line.end_m)
    cars = random_parked_cars(rng, [stretch])
    s, t = far.line.project(np.array([(car.x_m, car.y_m) for car in cars]))
    assert {round(float(offset), 2) for offset in t} == {5.15, -3.5}
    for car, along, offset in zip(cars, s, t, strict=True):
        ahead = math.cos(car.yaw_rad - float(far.line.at(np.array([along])).heading_rad[0]))
        assert ahead == pytest.approx(-math.copysign(1.0, offset))
        assert car.roll_rad == pytest.approx(0.0 if offset < 0 else -math.atan(0.12 / 1.5))


def test_pavements_stand_on_no_carriageway(roads: list[Road]) -> None:
    for road in roads:
        for side in (1, -1):
            if not road.has_kerb(side):
                continue
            for start, end in road.closed(side, 0.0, road.line.start_m, road.line.end_m):
                s = np.arange(start + 0.3, end - 0.3, 0.4)
                plan = road.line.plan(s, side * (road.half_width(s) + 1.0))
                assert not any(holds(other, plan).any() for other in roads if other is not road)
    turning = [road for road in roads if road.connecting and road.kerbs != (False, False)]
    assert [road.kerbs for road in turning] == [(False, True)] * 4
    assert all(road.closed(-1, 0.0, road.line.start_m, road.line.end_m) for road in turning)


@pytest.mark.parametrize("seed", SEEDS)
def test_routes_are_continuous_and_follow_their_lanes(crossing: OpenDriveMap, seed: int) -> None:
    rng, lanes = np.random.default_rng(seed), Lanes(crossing.roads)
    start = lanes.starts[int(rng.integers(len(lanes.starts)))]
    route = lanes.route(rng, start, 450.0)
    assert len(set(route)) == len(route)
    by_key = {lane.key: lane for lane in driven_lanes(crossing)}
    for one, other in pairwise(route):
        assert other in by_key[one].successors
    line = lanes.path(route).line
    s = np.arange(line.start_m, line.end_m, 0.1)
    at = line.at(s)
    assert np.linalg.norm(np.diff(at.position_m, axis=0), axis=1).max() < 0.102
    assert np.abs(np.diff(np.unwrap(at.heading_rad))).max() < math.radians(2)
    for key in route:
        points = by_key[key].centre_m
        foot, off = line.project(points[:, :2])
        assert np.abs(off).max() < 0.05
        assert line.at(foot).position_m[:, 2] == pytest.approx(points[:, 2], abs=0.05)
        turned = line.at(foot).heading_rad - by_key[key].heading_rad - (0 if by_key[key].travels_along_s else math.pi)
        inside = (foot > line.start_m + 1) & (foot < line.end_m - 1)
        assert np.abs(np.sin(turned[inside])).max() < math.sin(math.radians(2))
        assert (np.cos(turned) > 0).all()


def test_a_ring_is_driven_round_once(tmp_path: FilePath) -> None:
    link = '<predecessor id="-1"/><successor id="-1"/>'
    lanes = xodr.section("", xodr.lane(-1, "driving", xodr.flat(3.5), link=link))
    radius, third = 50.0, 2 * math.pi / 3
    pieces = []
    for number in range(3):
        x, y = radius * math.sin(third * number), -radius * math.cos(third * number)
        arc = xodr.geometry(0, x, y, third * number, radius * third, f'<arc curvature="{1 / radius}"/>')
        before, after = (number - 1) % 3, (number + 1) % 3
        linked = f'<predecessor elementType="road" elementId="{before}" contactPoint="end"/>'
        linked += f'<successor elementType="road" elementId="{after}" contactPoint="start"/>'
        pieces.append(xodr.road(number, radius * third, arc, lanes, linked))
    path = tmp_path / "ring.xodr"
    path.write_text(f"<OpenDRIVE>{''.join(pieces)}</OpenDRIVE>")
    ring = Lanes(read_opendrive(path, origin=LatLon(latitude_deg=1, longitude_deg=2)).roads)
    route = ring.route(np.random.default_rng(1), ring.starts[0], 1e4)
    assert [key.road_id for key in route] == [0, 1, 2]
    assert ring.path(route).line.length_m == pytest.approx(2 * math.pi * 51.75, abs=0.1)


def test_a_route_takes_what_nobody_has_taken_first(crossing: OpenDriveMap) -> None:
    lanes, rng = Lanes(crossing.roads), np.random.default_rng(1)
    start = next(key for key in lanes.starts if key[0] == WEST and key[2] > 0)
    ways = [lanes.route(rng, start, 300.0) for _ in range(20)]
    onward = {way[1] for way in ways}
    assert len(onward) == 3
    free = onward.pop()
    assert all(lanes.route(rng, start, 300.0, taken=onward)[1] == free for _ in range(10))


def test_the_same_seed_gives_the_same_course_and_another_seed_another(crossing: OpenDriveMap) -> None:
    def summary(seed: int) -> bytes:
        course = map_course(crossing, seed, WorldPlan(), convoy())
        street = course.street
        ways = [lane.line.at(np.linspace(0, lane.line.end_m, 9)).position_m for lane in course.lanes]
        places = [(o.x_m, o.y_m, o.yaw_rad, o.shape.footprint_area_m2) for o in street.obstacles]
        return pickle.dumps((ways, places, street.parked_cars, [(f.x_m, f.y_m) for f in street.features]))

    assert summary(7) == summary(7)
    assert summary(7) != summary(8)


@pytest.mark.parametrize("seed", SEEDS)
def test_obstacles_lie_on_lanes_and_most_of_them_in_that_of_the_egos(crossing: OpenDriveMap, seed: int) -> None:
    course = map_course(crossing, seed, WorldPlan(), convoy(15.0))
    xy = np.array([(o.x_m, o.y_m) for o in course.street.obstacles])
    off = np.array([np.abs(lane.line.project(xy)[1]) for lane in course.lanes])
    assert (off.min(axis=0) < 1.75).all()
    assert (off[0] < 1.75).mean() > 0.5
    assert len(xy) >= 5
    assert [o.obstacle_id for o in course.street.obstacles] == list(range(1, len(xy) + 1))


def test_the_street_lies_where_the_map_says(crossing: OpenDriveMap) -> None:
    street = map_course(crossing, 1, WorldPlan(), convoy()).street
    assert street.georeference.position == crossing.place.position
    middle = street.georeference.enu_from_geodetic(LatLon(latitude_deg=38.2466, longitude_deg=21.7346), 0.0)
    expected = street.enu_from_street[:2, :2] @ -np.array(crossing.middle_m)
    assert middle[:2] == pytest.approx(expected, abs=0.02)


def test_egos_stay_on_lanes_of_the_map(crossing: OpenDriveMap, happening: Scenario) -> None:
    by_point = np.concatenate([lane.centre_m for lane in driven_lanes(crossing)])
    for ego in happening.egos:
        times = np.arange(0.0, ego.start_s + 20.0, 0.1)
        poses = ego.trajectory.poses(times)
        apart = np.linalg.norm(poses[:, None, :2, 3] - by_point[None, :, :2], axis=2)
        nearest = apart.argmin(axis=1)
        # Drivers weave by 8 cm; points are a metre apart.
        assert apart.min(axis=1).max() < math.hypot(0.5, 0.3)
        assert poses[:, 2, 3] == pytest.approx(by_point[nearest, 2], abs=0.06)
        assert ego.trajectory.speed(times).max() < 50 / 3.6 * 1.05


def test_no_car_drives_through_another_or_through_a_parked_one(happening: Scenario) -> None:
    cars = [mover for mover in happening.movers if mover.model.radius_m > 2]
    assert len(cars) >= 6
    space = RoadSpace(happening.changing.street.parked_cars, 20.0)
    assert all(space.take_if_free(car.motion) for car in cars)
    assert [mover.number for mover in happening.movers] == list(range(1, len(happening.movers) + 1))


def test_room_on_the_road_is_given_once() -> None:
    parked = ParkedCar(30.0, 0.0, 0.0, 0.0, 0.0, (0.5, 0.5, 0.5))
    space = RoadSpace([parked], 1.0)
    assert space.take_if_free(Standing(pose(0.0, 0.0, 0.0)))
    assert not space.take_if_free(Standing(pose(4.0, 0.5, 0.0)))
    assert space.take_if_free(Standing(pose(0.0, 2.2, 0.0)))
    assert space.take_if_free(Standing(pose(5.5, 0.0, 0.0)))
    assert not space.take_if_free(Standing(pose(28.0, 1.0, 0.0, yaw_rad=1.5)))


def test_scenarios_of_a_map_are_the_same_each_time() -> None:
    def motions() -> bytes:
        there = scenario(ScenarioPlan(3, egos=2, seconds=6.0, map_file=MapFile.at(EXAMPLE)))
        poses = [mover.motion.poses(np.linspace(0, 6, 5)) for mover in there.movers]
        return pickle.dumps((poses, there.changing.truth()))

    assert motions() == motions()


def test_a_way_that_comes_back_to_itself_is_told_from_one_that_only_bends() -> None:
    turned = np.linspace(0, 1.9 * math.pi, 200)
    loop = np.stack([30 * np.sin(turned), 30 * (1 - np.cos(turned)), 0 * turned], axis=1)
    ahead = np.array([[x, 0.0, 0.0] for x in range(-60, 0)])
    on = np.array([loop[-1] + (x, 4.0 - 0.3 * x, 0.0) for x in range(1, 60)])
    assert not crosses_itself(Path(np.concatenate([ahead, loop[:120]]), np.zeros(180)))
    assert crosses_itself(Path(np.concatenate([ahead, loop, on]), np.zeros(60 + 200 + 59)))


def test_a_map_that_is_too_short_is_refused_with_what_would_fit(crossing: OpenDriveMap) -> None:
    with pytest.raises(
        OpenDriveError, match=r"longest route .* is 6\d\d m: .*use --seconds (\d+\.?\d*) or less"
    ) as caught:
        map_course(crossing, 1, WorldPlan(), convoy(200.0))
    fits = float(str(caught.value).split("--seconds ")[1].split(" ")[0])
    assert 20 < fits < 60
    course = map_course(crossing, 1, WorldPlan(), convoy(fits - 1.0))
    assert last_start_m(course.lanes[0], fits) >= BEHIND_M + 60.0


def test_a_map_without_a_way_for_that_many_cars_says_so(tmp_path: FilePath) -> None:
    path = tmp_path / "town.xodr"
    path.write_text(town())
    # Its junction lies 3.5 m below the road that leads to it: nobody drives down there.
    with pytest.raises(OpenDriveError, match=r"52 m: too short for 2 vehicles.*fewer --egos or a larger map"):
        map_course(read_opendrive(path), 1, WorldPlan(), convoy())
    path.write_text(town().replace('"driving"', '"sidewalk"'))
    with pytest.raises(OpenDriveError, match="no lane of type driving"):
        map_course(read_opendrive(path), 1, WorldPlan(), convoy())


def test_very_short_roads_are_drawn_too(tmp_path: FilePath) -> None:
    path = tmp_path / "town.xodr"
    path.write_text(town().replace('<laneSection s="20">', '<laneSection s="0.4">'))
    (short, long), *_ = (roads_of(road) for road in read_opendrive(path).roads)
    assert short.line.length_m == pytest.approx(0.44, abs=0.01)
    assert 2 * short.half_width(np.array([0.2])) == pytest.approx([6.5 * math.cos(0.03)], abs=0.01)
    assert long.line.length_m > 49


def test_a_file_that_changes_while_it_is_used_is_noticed(tmp_path: FilePath) -> None:
    path = tmp_path / "town.xodr"
    path.write_text(town())
    file = MapFile.at(path)
    assert file.named["file"] == "town.xodr"
    path.write_text(town() + " ")
    with pytest.raises(OpenDriveError, match="was changed"):
        file.read()
    with pytest.raises(OpenDriveError, match="cannot be read"):
        MapFile.at(tmp_path / "absent.xodr")


def test_all_parts_of_a_course_belong_to_its_street(crossing: OpenDriveMap) -> None:
    course: Course = map_course(crossing, 2, WorldPlan(), convoy())
    assert all(any(stretch.road is road for road in course.street.roads) for stretch in course.stretches)
    assert course.stretches[0].road is course.street.main
    assert not any(stretch.road.connecting for stretch in course.stretches)
