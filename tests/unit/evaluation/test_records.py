"""Records of road crews: read with their faults, and replayed through the rule."""

from __future__ import annotations

import asyncio
from datetime import timedelta
from pathlib import Path

import pytest

from evaluation.records import Record, RecordsError, distinct_places, read_records, replay_records
from server.geometry.geodesy import offset_from
from tests.unit.server.making import NOON, PATRAS

HEADER = "dtTime,VehicleName,Latitude,Longitude\n"


def record(east_m: float, days: float, vehicle: str = "DP1") -> Record:
    return Record(NOON + timedelta(days=days), vehicle, offset_from(PATRAS, east_m, 0.0))


def replayed(tmp_path: Path, *records: Record, accuracy_m: float = 5.0):  # type: ignore[no-untyped-def]  # Replayed
    url = f"sqlite+aiosqlite:///{tmp_path}/records.sqlite3"
    return asyncio.run(replay_records(records, accuracy_m, url, lambda _: None))


@pytest.mark.parametrize(("line", "swapped"), [("43.05,-76.11", False), ("-76.11,43.05", True)])
def test_swapped_coordinates_are_noticed(tmp_path: Path, line: str, swapped: bool) -> None:
    """At 76 degrees south there are no roads."""
    path = tmp_path / "records.csv"
    path.write_text(f"{HEADER}4/13/2016 8:08,DP2,{line}\n4/12/2016 7:54,DP1,{line}\n")
    found, was_swapped = read_records(path)
    assert was_swapped is swapped
    assert {(item.position.latitude_deg, item.position.longitude_deg) for item in found} == {(43.05, -76.11)}
    assert [item.vehicle for item in found] == ["DP1", "DP2"]


@pytest.mark.parametrize(
    "text", ["", HEADER, HEADER + "x,DP1,1,2\n", HEADER + "4/12/2016 7:54,DP1,nan,2\n", "a,b\n1,2\n"]
)
def test_what_holds_no_records_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "records.csv"
    path.write_text(text)
    with pytest.raises(RecordsError, match=r"records\.csv"):
        read_records(path)


def test_records_within_the_accuracy_are_one_obstacle_and_others_are_not(tmp_path: Path) -> None:
    done = replayed(tmp_path, record(0, 0), record(6, 1, "DP2"), record(-4, 2), record(60, 2.1))
    assert (done.records, done.obstacles) == (4, {"confirmed": 1, "candidate": 1})
    assert sorted(done.sightings) == [1, 3]


def test_what_nobody_sees_again_expires_and_comes_back_as_another(tmp_path: Path) -> None:
    done = replayed(tmp_path, record(0, 0), record(0, 200))
    assert done.obstacles == {"expired": 1, "candidate": 1}


def test_groups_of_records_shrink_with_the_distance() -> None:
    records = [record(east_m, 0) for east_m in (0.0, 4.0, 8.0, 100.0)]
    assert [distinct_places(records, within_m) for within_m in (1, 5, 10, 200)] == [4, 3, 2, 1]
