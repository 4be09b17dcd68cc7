"""Which obstacle is which detection."""

from __future__ import annotations

import numpy as np
import pymap3d
from hypothesis import given, settings
from hypothesis import strategies as st

from contract.geometry import LatLon
from server.geometry.geodesy import distance_m, east_north_m, offset_from
from server.geometry.symmetric import Symmetric
from server.life.matching import match, match_jointly
from server.life.policy import COOPERATION
from tests.unit.server.making import HOUR, NOON, PATRAS, Road, detection, message

offsets = st.floats(-500, 500)


places = st.builds(LatLon, latitude_deg=st.floats(-84, 84), longitude_deg=st.floats(-180, 180))


@given(places, offsets, offsets)
@settings(max_examples=200, deadline=None)
def test_offsets_survive_the_way_over_the_ellipsoid(origin: LatLon, east_m: float, north_m: float) -> None:
    there = offset_from(origin, east_m, north_m)
    assert np.allclose(east_north_m(there, origin), [east_m, north_m], atol=1e-4)
    assert abs(distance_m(origin, there) - np.hypot(east_m, north_m)) < 1e-3


@given(places, offsets, offsets)
@settings(max_examples=200, deadline=None)
def test_the_plane_is_that_of_pymap3d(origin: LatLon, east_m: float, north_m: float) -> None:
    there = offset_from(origin, east_m, north_m)
    at = (there.latitude_deg, there.longitude_deg, 0.0)
    theirs = pymap3d.geodetic2enu(*at, origin.latitude_deg, origin.longitude_deg, 0.0)
    assert np.allclose(east_north_m(there, origin), theirs[:2], atol=1e-6)


@given(st.floats(0.01, 100), st.floats(0.01, 100), st.floats(-0.99, 0.99), st.floats(0.01, 50))
def test_a_floored_covariance_keeps_its_axes(xx: float, yy: float, correlation: float, least: float) -> None:
    matrix = Symmetric(xx, correlation * np.sqrt(xx * yy), yy)
    values, vectors = np.linalg.eigh([[matrix.xx, matrix.xy], [matrix.xy, matrix.yy]])
    wanted = vectors @ np.diag(np.maximum(values, least)) @ vectors.T
    floored = matrix.floored(least)
    assert np.allclose([[floored.xx, floored.xy], [floored.xy, floored.yy]], wanted, atol=1e-6)


def test_a_common_offset_of_the_report_is_estimated() -> None:
    """Three holes 3 m apart, a report 2.5 m off: each is found, none is taken for its neighbour."""
    road = Road()
    holes = [(0.0, 0.0), (3.0, 0.0), (0.0, 4.0)]
    road.sees("ego1", NOON, *(detection(e, n) for e, n in holes), pose_sd_m=1.5)
    ids = list(road.obstacles)
    again = road.sees("ego2", NOON + HOUR, *(detection(e + 2.5, n) for e, n in holes), pose_sd_m=1.5)
    assert [d.obstacle.id for d in again if d.obstacle] == ids


def test_matching_is_one_to_one() -> None:
    road = Road()
    road.sees("ego1", NOON, detection(0, 0))
    again = road.sees("ego2", NOON + HOUR, detection(0.2, 0), detection(2.0, 0))
    assert sorted(decision.outcome.value for decision in again if decision.index is not None) == ["created", "kept"]


def test_shape_decides_between_neighbours_at_the_same_distance() -> None:
    road = Road()
    road.sees("ego1", NOON, detection(-1.5, 0, 400, 350), detection(1.5, 0, 2000, 1500))
    small, large = road.obstacles.values()
    for wanted, seen in ((small, detection(0, 0, 400, 350)), (large, detection(0, 0, 2000, 1500))):
        (decision,) = _copy(road).sees("ego2", NOON + HOUR, seen, pose_sd_m=2.0)
        assert decision.obstacle is not None
        assert decision.obstacle.id == wanted.id


def _copy(road: Road) -> Road:
    copy = Road(road.policy)
    copy.obstacles = dict(road.obstacles)
    return copy


def test_the_gate_grows_with_the_covariances() -> None:
    decisions = []
    for pose_sd_m in (0.2, 3.0):
        road = Road()
        road.sees("ego1", NOON, detection(0, 0), pose_sd_m=pose_sd_m)
        decisions += road.sees("ego2", NOON + HOUR, detection(5, 0), pose_sd_m=pose_sd_m)
    assert [decision.outcome.value for decision in decisions] == ["created", "kept"]


def test_a_bridge_above_is_another_place() -> None:
    road = Road()
    road.sees("ego1", NOON, detection(), altitude_sd_m=0.5)
    (decision,) = road.sees("ego2", NOON + HOUR, detection(), altitude_m=28.0, altitude_sd_m=0.5)
    assert decision.outcome.value == "created"


def test_five_holes_stay_five_under_gnss_noise() -> None:
    """Twenty passes, GNSS 1.5 m per pass: without the common shift 0.17 duplicates an obstacle were measured."""
    random, road = np.random.default_rng(3), Road()
    holes = np.array([[0, 0], [1.5, 0.5], [4, -1], [6, 2], [9, 0]], dtype=float)
    for number in range(20):
        bias = random.normal(0, 1.5, 2)
        seen = [detection(*(hole + bias + random.normal(0, 0.03, 2)), 700, 500) for hole in holes]
        road.sees(f"ego{number}", NOON + number * HOUR, *seen, pose_sd_m=1.5)
    assert len(road.obstacles) == 5
    found = np.array([east_north_m(o.place.position, PATRAS) for o in road.obstacles.values()])
    errors_m = np.linalg.norm(found[:, None] - holes[None], axis=2).min(axis=1)
    assert float(np.median(errors_m)) < 1.0


def test_an_unmatched_report_among_many_obstacles_is_bounded() -> None:
    road = Road()
    for number in range(6):
        seen = [detection(3.0 * east, 3.0 * number, 500, 400) for east in range(10)]
        road.sees("ego1", NOON, *seen, pose_sd_m=0.3)
    assert len(road.obstacles) == 60
    again = [detection(3.0 * east, 6.0, 500, 400) for east in range(10)]
    assert {d.outcome.value for d in road.sees("ego2", NOON + HOUR, *again, pose_sd_m=0.3)} == {"kept"}


holes = st.tuples(st.floats(-30, 30), st.floats(-30, 30))


@given(holes, st.lists(holes, min_size=1, max_size=8), st.floats(0.1, 5.0))
@settings(deadline=None)
def test_one_detection_alone_is_matched_as_among_others(
    seen: tuple[float, float], stored: list[tuple[float, float]], pose_sd_m: float
) -> None:
    road = Road()
    for number, hole in enumerate(stored):
        road.sees(f"ego{number}", NOON, detection(*hole), pose_sd_m=1.0)
    obstacles = tuple(road.obstacles.values())
    report = message(detection(*seen), vehicle="ego", at=NOON + HOUR, pose_sd_m=pose_sd_m)
    alone = match(report, report.detections, obstacles, COOPERATION.matching)
    jointly = match_jointly(report, report.detections, obstacles, COOPERATION.matching)
    assert alone.obstacle_of == jointly.obstacle_of
    assert np.allclose(alone.shift_m, jointly.shift_m, atol=1e-9)
