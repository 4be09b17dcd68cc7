"""What leaves the car: nothing of quiet zones, no exact place of the car, no name that lasts."""

from __future__ import annotations

import json
import math
from itertools import pairwise
from pathlib import Path
from uuid import UUID

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contract.geometry import LatLon
from contract.observation import Inspection, ObservationReport, Outcome
from server.life.policy import Plausibility
from tests.unit.server.making import NOON, PATRAS, detection, message
from vehicle_client.area import distance_m
from vehicle_client.frames import GeoOrigin
from vehicle_client.privacy.pseudonym import PAUSE_S, ROTATED_S, Pseudonyms
from vehicle_client.privacy.quiet_zones import QuietZone, ZoneError, is_hidden, read_zones
from vehicle_client.privacy.report_privacy import (
    ORIGIN_GRID_DEG,
    POSITION_GRID_DEG,
    Privacy,
    coarse,
    departing,
    position_told,
)
from vehicle_client.watching import INSPECTED_M

SPEED_SLACK_M = Plausibility().speed_slack_m
"""What the server forgives two origins of one moment."""

places = st.builds(
    lambda lat, lon: LatLon(latitude_deg=lat, longitude_deg=lon), st.floats(-84, 84), st.floats(-180, 180)
)


def at(east_m: float, north_m: float, origin: LatLon = PATRAS) -> LatLon:
    return GeoOrigin(origin, 0.0).geodetic(np.array([east_m, north_m, 0.0]))[0]


def nowhere(_: UUID) -> LatLon | None:
    return None


def looks(*numbers: int) -> tuple[Inspection, ...]:
    return tuple(Inspection(obstacle_id=UUID(int=n), outcome=Outcome.ABSENT, visible_fraction=1.0) for n in numbers)


def place_of(report: ObservationReport, index: int = 0) -> tuple[LatLon, float]:
    seen = report.detections[index]
    origin = GeoOrigin(report.origin.position, report.origin.altitude_m)
    return origin.geodetic(np.array([seen.east_m, seen.north_m, seen.up_m]))


@settings(max_examples=100, deadline=None)
@given(places, st.floats(-100, 100), st.floats(-100, 100), st.floats(-5, 5))
def test_an_obstacle_stays_where_it_is_when_the_origin_gets_coarse(
    position: LatLon, east_m: float, north_m: float, up_m: float
) -> None:
    seen = detection(east_m, north_m).model_copy(update={"up_m": up_m})
    report = message(seen, position=position)
    left = departing(report, Privacy(), nowhere)
    assert left is not None
    (before, high_m), (after, altitude_m) = place_of(report), place_of(left)
    assert distance_m(before, after) < 0.001
    assert altitude_m == pytest.approx(high_m, abs=0.001)
    assert ObservationReport.model_validate_json(left.model_dump_json()) == left


@given(places, st.floats(-2, 2), st.floats(-2, 2))
def test_origins_of_a_moment_are_no_two_vehicles_to_the_server(position: LatLon, east_m: float, north_m: float) -> None:
    here, there = coarse(position, ORIGIN_GRID_DEG), coarse(at(east_m, north_m, position), ORIGIN_GRID_DEG)
    assert distance_m(here, there) < SPEED_SLACK_M
    assert distance_m(here, position) < SPEED_SLACK_M / 2


@pytest.mark.parametrize("latitude_deg", [0.0, 38.0, 60.0])
def test_the_grid_is_coarser_than_what_the_places_of_a_report_tell_of_the_car(latitude_deg: float) -> None:
    """A report speaks of places at most 18 m away."""
    half_cell_deg = 0.499 * ORIGIN_GRID_DEG
    middle = coarse(LatLon(latitude_deg=latitude_deg, longitude_deg=21.0), ORIGIN_GRID_DEG)
    corner = LatLon(
        latitude_deg=middle.latitude_deg + half_cell_deg, longitude_deg=middle.longitude_deg + half_cell_deg
    )
    assert coarse(corner, ORIGIN_GRID_DEG) == middle
    assert distance_m(corner, middle) >= INSPECTED_M


def test_cars_on_one_spot_of_the_grid_cannot_be_told_apart() -> None:
    reports = [
        departing(message(detection(10 - e, 5), position=at(e, 0, coarse(PATRAS, ORIGIN_GRID_DEG))), Privacy(), nowhere)
        for e in (-8.0, 0.0, 8.0)
    ]
    assert len({r.origin.position for r in reports if r is not None}) == 1


def test_the_heading_leaves_as_one_of_eight() -> None:
    headings = set()
    for degree in range(360):
        report = message(detection())
        origin = report.origin.model_copy(update={"heading_rad": math.radians(degree)})
        left = departing(report.model_copy(update={"origin": origin}), Privacy(), nowhere)
        assert left is not None
        headings.add(round(math.degrees(left.origin.heading_rad), 6))
        assert 0 <= left.origin.heading_rad < 2 * math.pi
    assert headings == {0, 45, 90, 135, 180, 225, 270, 315}


HOME = QuietZone(PATRAS, 300.0)


@pytest.mark.parametrize(("east_m", "leaves"), [(0, False), (299, False), (330, True)])
def test_from_within_a_quiet_zone_nothing_is_reported(east_m: float, leaves: bool) -> None:
    report = message(detection(30, 0), position=at(east_m, 0))
    assert (departing(report, Privacy(zones=(HOME,)), nowhere) is not None) is leaves


def test_what_is_seen_in_a_quiet_zone_from_outside_stays_in_the_car() -> None:
    known = {UUID(int=1): at(290, 0), UUID(int=2): at(340, 0)}
    report = message(detection(-30, 0), detection(20, 0), inspections=looks(1, 2, 3), position=at(320, 0))
    left = departing(report, Privacy(zones=(HOME,)), known.get)
    assert left is not None
    assert [round(distance_m(place_of(left, n)[0], at(340, 0))) for n in range(len(left.detections))] == [0]
    # The third is not known, and might lie there.
    assert [i.obstacle_id.int for i in left.inspections] == [2]
    only_there = message(detection(-30, 0), inspections=looks(1), position=at(320, 0))
    assert departing(only_there, Privacy(zones=(HOME,)), known.get) is None


@settings(max_examples=200, deadline=None)
@given(
    st.floats(-600, 600),
    st.floats(-600, 600),
    st.floats(150, 500),
    st.lists(st.tuples(st.floats(-100, 100), st.floats(-100, 100)), max_size=4),
)
def test_nothing_that_leaves_lies_in_a_quiet_zone(
    east_m: float, north_m: float, radius_m: float, seen: list[tuple[float, float]]
) -> None:
    zones = (QuietZone(PATRAS, radius_m), QuietZone(at(500, 0), 200.0))
    here = at(east_m, north_m)
    left = departing(message(*[detection(*place) for place in seen], position=here), Privacy(zones=zones), nowhere)
    told = position_told(here, Privacy(zones=zones))
    if is_hidden(here, zones):
        assert left is None
        assert told is None
    if left is not None:
        assert not any(is_hidden(place_of(left, n)[0], zones) for n in range(len(left.detections)))
        assert not is_hidden(left.origin.position, zones)
    if told is not None:
        assert not is_hidden(told, zones)


@given(places)
def test_the_server_is_told_a_coarse_position(position: LatLon) -> None:
    told = position_told(position, Privacy())
    assert told is not None
    assert distance_m(told, position) < 80
    assert told == coarse(told, POSITION_GRID_DEG)
    assert len(str(told.latitude_deg).partition(".")[2]) <= 3


def names(stamps: list[float]) -> list[str]:
    numbers = iter(range(1_000_000))
    pseudonyms = Pseudonyms(lambda: f"car-{next(numbers)}")
    return [pseudonyms.at(stamp) for stamp in stamps]


def test_a_name_lasts_ten_minutes_of_driving() -> None:
    drawn = names([60.0 * n for n in range(31)])
    assert drawn[:10] == ["car-0"] * 10
    assert drawn[10:20] == ["car-1"] * 10
    assert drawn[30] == "car-3"


def test_after_a_pause_the_car_has_another_name() -> None:
    assert names([0, 50, 50 + PAUSE_S - 1, 50 + 2 * PAUSE_S]) == ["car-0", "car-0", "car-0", "car-1"]
    assert names([1000, 900]) == ["car-0", "car-1"]


@given(st.lists(st.floats(0, 1e5), min_size=2, max_size=40))
def test_no_name_comes_again_or_lasts_too_long(stamps: list[float]) -> None:
    drawn = names(sorted(stamps))
    assert [int(name[4:]) for name in drawn] == sorted(int(name[4:]) for name in drawn)
    for name in set(drawn):
        spans = [stamp for stamp, had in zip(sorted(stamps), drawn, strict=True) if had == name]
        assert spans[-1] - spans[0] < ROTATED_S
        assert all(later - earlier < PAUSE_S for earlier, later in pairwise(spans))


def test_a_report_keeps_the_name_that_it_was_made_with_and_names_of_a_car_are_random() -> None:
    privacy = Privacy(pseudonyms=Pseudonyms())
    first, second, later = (departing(message(detection(), at=NOON, number=n), privacy, nowhere) for n in range(3))
    assert first is not None
    assert second is not None
    assert first.pseudonym == second.pseudonym != "ego1"
    assert Pseudonyms().at(0) != Pseudonyms().at(0)
    assert later is not None
    kept = departing(message(detection(), vehicle="ego7"), Privacy(), nowhere)
    assert kept is not None
    assert kept.pseudonym == "ego7"


def test_zones_are_read_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "quiet.json"
    path.write_text(json.dumps([{"latitude_deg": 38.2, "longitude_deg": 21.7, "radius_m": 300}]))
    assert read_zones(path) == (QuietZone(LatLon(latitude_deg=38.2, longitude_deg=21.7), 300.0),)


def zone(latitude: str = "38.2", radius: str = "300") -> str:
    return f'[{{"latitude_deg": {latitude}, "longitude_deg": 21.7, "radius_m": {radius}}}]'


@pytest.mark.parametrize(
    "text",
    ["", "{", "{}", "[1]", "[{}]", zone("98"), zone("NaN"), zone('"north"'), zone(radius="10"), zone(radius="-1")],
)
def test_a_file_that_is_no_list_of_zones_is_refused_with_what_was_expected(tmp_path: Path, text: str) -> None:
    path = tmp_path / "quiet.json"
    path.write_text(text)
    with pytest.raises(ZoneError, match=r"quiet\.json: .*expected a list of"):
        read_zones(path)
    with pytest.raises(ZoneError, match="No such file"):
        read_zones(tmp_path / "none.json")
