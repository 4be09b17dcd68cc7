"""Queries of the benchmark: the service sees the same circle in all of them, and boxes are as large as circles."""

from __future__ import annotations

import json
import math
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.peer_servers import PEERS
from benchmarks.server_data import synthetic_city
from benchmarks.server_load import Cost, Load
from benchmarks.server_processes import Measured
from benchmarks.server_queries import (
    box_about,
    box_path,
    circle_path,
    filtered_path,
    near_obstacles,
    one_in_each_tile,
    write_queries,
)
from benchmarks.server_report import Report, Row
from benchmarks.server_turns import Subject
from contract.geometry import Kind, LatLon
from server.geometry.geodesy import distance_m
from server.reading.around import Circle
from server.reading.query import ObstacleQuery
from server.reading.remembered import circle_of
from server.web.nearby_route import parsed


def _query(text: str, *lists: str) -> ObstacleQuery:
    named = parse_qs(text)
    return ObstacleQuery.model_validate({name: value if name in lists else value[0] for name, value in named.items()})


latitudes = st.floats(-70, 70).map(lambda value: round(value, 7))
longitudes = st.floats(-179, 179).map(lambda value: round(value, 7))


@given(latitudes, longitudes)
def test_a_plain_circle_is_answered_at_once_a_filtered_one_and_a_box_from_memory(
    lat_deg: float, lon_deg: float
) -> None:
    asked = parsed(urlsplit(circle_path(lat_deg, lon_deg, 300.0)).query.encode())
    assert asked is not None
    assert (asked.centre.latitude_deg, asked.centre.longitude_deg, asked.radius_m) == (lat_deg, lon_deg, 300.0)
    filtered = urlsplit(filtered_path(lat_deg, lon_deg, 300.0)).query
    assert parsed(filtered.encode()) is None
    query = _query(filtered, "kind")
    assert query.filters.kinds == {Kind.POTHOLE, Kind.BUMP}, "all that the benchmark stores"
    assert isinstance(query.area, Circle)
    assert circle_of(query.area, query.filters) == query.area
    box = _query(urlsplit(box_path(lat_deg, lon_deg, 300.0)).query)
    about = circle_of(box.area, box.filters)
    assert about is not None
    assert about.radius_m < 400
    assert distance_m(about.centre, LatLon(latitude_deg=lat_deg, longitude_deg=lon_deg)) < 1


@given(latitudes, longitudes, st.floats(10, 2_000))
def test_a_box_has_the_area_of_the_circle_about_the_same_place(lat_deg: float, lon_deg: float, radius_m: float) -> None:
    west, south, east, north = box_about(lat_deg, lon_deg, radius_m)
    height_m = math.radians(north - south) * 6_378_137
    width_m = math.radians(east - west) * 6_378_137 * math.cos(math.radians(lat_deg))
    assert height_m * width_m == pytest.approx(math.pi * radius_m**2, rel=1e-3)
    assert (west + east) / 2 == pytest.approx(lon_deg, abs=1e-9)
    assert (south + north) / 2 == pytest.approx(lat_deg, abs=1e-9)


def test_every_peer_is_asked_about_the_place_and_for_as_many_as_the_service_gives() -> None:
    for peer in PEERS[1:]:
        query = parse_qs(urlsplit(peer.path_of(40.0, -74.0, 300.0)).query)
        west, south, east, north = map(float, query["bbox"][0].split(","))
        assert west < -74.0 < east
        assert south < 40.0 < north
        assert query["limit"] == ["1000"]


def test_places_are_the_same_for_the_same_seed_and_one_line_each(tmp_path: Path) -> None:
    city = synthetic_city(1, 2_000).places_deg
    places, again, other = (near_obstacles(city, 500, seed) for seed in (1, 1, 2))
    assert np.array_equal(places, again)
    assert not np.array_equal(places, other)
    load = write_queries(tmp_path / "queries", places)
    lines = load.lines.read_text().splitlines()
    assert len(lines) == 500
    assert lines[0] == circle_path(places[0, 0], places[0, 1], 300.0)


def test_the_tour_has_one_place_in_every_tile_and_no_tile_twice() -> None:
    tour = one_in_each_tile(synthetic_city(1, 2_000).places_deg)
    assert len(one_in_each_tile(tour)) == len(tour) > 1


def test_a_slow_server_is_paced_on_few_connections_that_are_never_idle_for_long() -> None:
    load = Load(Path("lines"), connections=32)
    for per_second in (0.5, 6.0, 25.0, 100.0, 5_000.0):
        paced = load.at(per_second)
        assert paced.connections / (paced.pause_ms / 1e3) == pytest.approx(per_second)
        assert 2 <= paced.connections <= 32
    assert load.at(25.0).pause_ms < 500
    assert load.at(5_000.0).connections == 32


def test_a_subject_at_a_pace_is_the_same_server_under_the_same_name() -> None:
    subject = Subject("HeadsUp", Measured("http://127.0.0.1:1", 1), Load(Path("lines")))
    paced = subject.at(640)
    assert (paced.name, paced.server) == (subject.name, subject.server)
    assert paced.load.pause_ms == pytest.approx(50)


def test_tables_tell_ratios_and_the_file_holds_every_round(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bare = Row("bare", [Cost(4_000, 1.0, 250.0, 0.0, 1.0, 8.0, 16_000.0)])
    own = Row("HeadsUp", [Cost(number, 1.0, 450.0, 50.0, 2.0, 20.0, 16_100.0) for number in (1_000, 2_000)])
    report = Report(seed=7)
    report.costs("Nearby", [bare, own], bare, own)
    report.latencies("At half", [own])
    report.note("What it means.")
    printed = capsys.readouterr().out
    assert "| HeadsUp | 0.450 | 0.050 | 1,500 | 0.500 | 0.375 | 1.00 | 16,100 |" in printed
    assert "| HeadsUp | 1,500 | 2.00 | 20.00 | 10.0 |" in printed
    lines = [line for line in printed.splitlines() if line.startswith("|")]
    assert {line.count("|") for line in lines[:4]} == {9}, "each line has as many cells as the heading"
    report.write(tmp_path / "report.json")
    said = json.loads((tmp_path / "report.json").read_text())
    assert (said["seed"], said["notes"]) == (7, ["What it means."])
    assert [len(row["rounds"]) for row in said["tables"][0]["rows"]] == [1, 2]
    assert said["tables"][0]["rows"][1]["rounds"][1]["requests"] == 2_000
