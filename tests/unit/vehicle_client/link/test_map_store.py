"""The map on disk: after a restart the driver is warned from it, and nothing on disk can keep the car from driving."""

from __future__ import annotations

import gzip
import resource
import stat
from datetime import timedelta
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.unit.vehicle_client.making import NOON_S, PATRAS, feature, map_of, pose_at
from vehicle_client.alerts import Alerts, choose
from vehicle_client.alignment import UNALIGNED
from vehicle_client.area import Area, Surveyed
from vehicle_client.link.map_store import SAVED_EVERY_S, VOUCHED_ANEW_S, MapStore
from vehicle_client.obstacle_map import REMEMBERED_S, ObstacleMap, apply, around

HOUR_S = 3600.0


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "map.json.gz"


def numbers(known: ObstacleMap) -> set[int]:
    return {i.int for i in (*known.obstacles, *known.remembered)}


def test_after_a_restart_without_network_the_driver_is_warned_and_told_that_the_map_is_not_fresh(path: Path) -> None:
    MapStore(path).save(map_of(feature(1, east_m=100.0)), NOON_S)
    here = pose_at(0.0, 0.0, stamp_s=NOON_S + HOUR_S)
    known = around(MapStore(path).load(), here.position, here.stamp_s)
    assert not known.is_fresh(here.stamp_s)
    alerts = choose(Alerts(), known, (), here, here.stamp_s, UNALIGNED)
    assert [hazard.obstacle_id.int for hazard in alerts.hazards if hazard.obstacle_id] == [1]
    assert not alerts.fresh


def test_what_the_server_says_then_takes_its_place(path: Path) -> None:
    MapStore(path).save(map_of(feature(1, 100.0), feature(2, 200.0), feature(3, 3_000.0)), NOON_S)
    known = around(MapStore(path).load(), PATRAS, NOON_S + HOUR_S)
    known = apply(known, Surveyed(Area(PATRAS, 600.0), (feature(2, 200.0, revision=2),)), NOON_S + HOUR_S)
    assert numbers(known) == {2, 3}
    assert known.is_fresh(NOON_S + HOUR_S)


def test_every_obstacle_keeps_its_own_age(path: Path) -> None:
    known = map_of(feature(1, 100.0), feature(2, 900.0))
    known = apply(known, Surveyed(Area(PATRAS, 600.0), (feature(1, 100.0),)), NOON_S + HOUR_S)
    MapStore(path).save(known, NOON_S + HOUR_S)
    loaded = MapStore(path).load()
    assert {i.int: (e.told_s, e.unvouched_s) for i, e in loaded.remembered.items()} == {
        1: (NOON_S, NOON_S + HOUR_S),
        2: (NOON_S, NOON_S),
    }
    assert numbers(around(loaded, PATRAS, NOON_S + REMEMBERED_S + HOUR_S / 2)) == {1}
    assert numbers(around(loaded, PATRAS, NOON_S + REMEMBERED_S + 2 * HOUR_S)) == set()


def test_what_has_expired_meanwhile_warns_nobody(path: Path) -> None:
    MapStore(path).save(map_of(feature(1, lives=timedelta(hours=1))), NOON_S)
    assert numbers(around(MapStore(path).load(), PATRAS, NOON_S + 2 * HOUR_S)) == set()


class Watched(MapStore):
    """Waits for each save to be over."""

    def save_if_due(self, known: ObstacleMap, now_s: float) -> None:
        super().save_if_due(known, now_s)
        if self._thread is not None:
            self._thread.join()


def test_it_is_written_once_a_minute_at_most_and_only_when_something_changed(path: Path) -> None:
    store, known = Watched(path), map_of(feature(1))
    store.save_if_due(known, NOON_S)
    store.save_if_due(known, NOON_S + SAVED_EVERY_S - 1)
    assert not path.exists()
    store.save_if_due(known, NOON_S + SAVED_EVERY_S)
    written = path.stat().st_mtime_ns
    store.save_if_due(known, NOON_S + 2 * SAVED_EVERY_S)
    assert path.stat().st_mtime_ns == written
    store.save_if_due(map_of(feature(2)), NOON_S + 3 * SAVED_EVERY_S)
    assert numbers(MapStore(path).load()) == {2}
    later = map_of(feature(2), heard_s=NOON_S + 2 * VOUCHED_ANEW_S)
    store.save_if_due(later, NOON_S + 2 * VOUCHED_ANEW_S)
    assert {e.unvouched_s for e in MapStore(path).load().remembered.values()} == {NOON_S + 2 * VOUCHED_ANEW_S}


def test_the_end_of_a_drive_waits_for_its_map(path: Path) -> None:
    store = MapStore(path)
    store.save_if_due(map_of(feature(1)), NOON_S)
    store.save_if_due(map_of(feature(2)), NOON_S + SAVED_EVERY_S)
    store.save(map_of(feature(3)), NOON_S + SAVED_EVERY_S + 1)
    assert numbers(MapStore(path).load()) == {3}


def test_a_first_drive_has_an_empty_map_and_says_nothing(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert MapStore(path).load() == ObstacleMap()
    assert caplog.records == []


BROKEN = [
    b"",
    b"nonsense",
    gzip.compress(b"{", mtime=0),
    gzip.compress(b'{"headsup_map":2}', mtime=0),
    gzip.compress(b'{"headsup_map":1}\n{"feature": 1}', mtime=0),
    gzip.compress(b"", mtime=0),
    b"\x1f\x8b\x08" + b"\0" * 50,
]


@pytest.mark.parametrize("content", BROKEN)
def test_a_file_that_cannot_be_used_is_ignored_with_one_line(
    path: Path, content: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    path.write_bytes(content)
    assert MapStore(path).load() == ObstacleMap()
    assert len(caplog.records) == 1
    assert "\n" not in caplog.records[0].getMessage()


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(cut=st.floats(0, 1), flipped=st.floats(0, 1), bit=st.integers(0, 7))
def test_a_file_that_was_cut_or_changed_anywhere_never_stops_the_car(
    tmp_path: Path, cut: float, flipped: float, bit: int
) -> None:
    path = tmp_path / "map.json.gz"
    MapStore(path).save(map_of(feature(1), feature(2, 50.0)), NOON_S)
    whole = bytearray(path.read_bytes())
    whole[int(flipped * (len(whole) - 1))] ^= 1 << bit
    path.write_bytes(whole[: max(1, int(cut * len(whole)))])
    assert numbers(MapStore(path).load()) in (set(), {1, 2})


def test_a_full_disk_leaves_the_old_map(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    store = MapStore(path)
    store.save(map_of(feature(1)), NOON_S)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, limits[1]))
    try:
        store.save(map_of(feature(2)), NOON_S + 100)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert "cannot be saved" in caplog.text
    assert numbers(MapStore(path).load()) == {1}
    assert list(path.parent.iterdir()) == [path]
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    store.save(map_of(feature(2)), NOON_S + 200)
    assert numbers(MapStore(path).load()) == {2}
