from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as stn

from vehicle_client.sources.frame import SourceError
from vehicle_client.sources.point_fields import record_type, seconds_after, sweep_of

STAMP_S = 1_780_000_000.25
SINCE_START_S = np.linspace(0, 0.1, 50)


def records(count: int = 50, **extra: np.ndarray) -> np.ndarray:
    columns = {axis: np.arange(count, dtype="<f4") for axis in "xyz"} | extra
    made = np.zeros(count, dtype=[(name, values.dtype) for name, values in columns.items()])
    for name, values in columns.items():
        made[name] = values
    return made


@pytest.mark.parametrize(
    ("name", "times"),
    [
        ("t", (SINCE_START_S * 1e9).astype("<u4")),  # Ouster
        ("time", SINCE_START_S.astype("<f4")),  # Velodyne
        ("timestamp", STAMP_S + SINCE_START_S),  # Hesai, RoboSense
        ("timestamp", (STAMP_S + SINCE_START_S) * 1e9),  # Livox
        ("offset_time", (SINCE_START_S * 1e9).astype("<u4")),  # Livox
        ("time_offset", SINCE_START_S * 1e6),
        ("time", SINCE_START_S * 1e3),
    ],
)
def test_the_unit_of_the_times_is_found_and_the_stamp_is_the_sweeps_end(name: str, times: np.ndarray) -> None:
    sweep = sweep_of(STAMP_S, records(**{name: times}))
    assert sweep.stamp_s == pytest.approx(STAMP_S + 0.1, abs=1e-5)
    assert sweep.point_time_s == pytest.approx(SINCE_START_S - 0.1, abs=1e-5)


def test_times_before_the_stamp_leave_it_where_it_is() -> None:
    sweep = sweep_of(STAMP_S, records(time=(SINCE_START_S - 0.1).astype("<f4")))
    assert sweep.stamp_s == pytest.approx(STAMP_S, abs=1e-6)
    assert sweep.point_time_s == pytest.approx(SINCE_START_S - 0.1, abs=1e-6)


@pytest.mark.parametrize("clock", [STAMP_S - 3600, 123.4])
def test_a_sensor_whose_clock_is_not_set_ends_its_sweep_at_the_stamp(clock: float) -> None:
    sweep = sweep_of(STAMP_S, records(timestamp=clock + SINCE_START_S))
    assert sweep.stamp_s == pytest.approx(STAMP_S, abs=1e-6)
    assert sweep.point_time_s == pytest.approx(SINCE_START_S - 0.1, abs=1e-5)


@pytest.mark.parametrize("times", [np.zeros(50), np.full(50, np.nan), np.linspace(0, 1e12, 50), np.full(50, "a")])
def test_times_that_make_no_sense_are_none(times: np.ndarray) -> None:
    assert seconds_after(STAMP_S, times) is None


def test_fields_are_found_in_any_order_type_and_byte_order() -> None:
    kind = record_type({"ring": (">u2", 0), "Z": (">f8", 2), "y": (">f4", 12), "X": (">f4", 16), "i": ("u1", 30)}, 31)
    made = np.zeros(3, dtype=kind)
    made["X"], made["y"], made["Z"], made["ring"], made["i"] = [1, 2, np.nan], 5, -1.5, [7, 8, 9], 200
    sweep = sweep_of(0.0, made)
    assert sweep.points_m[0].tolist() == [1, 5, -1.5]
    assert sweep.points_m.dtype == np.dtype("=f4")
    assert np.isnan(sweep.points_m[2, 0])
    assert sweep.ring.tolist() == [7, 8, 9]
    assert sweep.intensity.tolist() == [200] * 3
    assert sweep.point_time_s is None


def test_a_ring_that_is_no_whole_number_is_left_out() -> None:
    assert sweep_of(0.0, records(ring=np.full(50, 0.5))).ring is None


@pytest.mark.parametrize(
    "bad",
    [
        records(0),
        records(x=np.full(50, np.nan)),
        np.zeros(4, dtype=[("x", "f4"), ("y", "f4")]),
        np.zeros(4, dtype="f4"),
    ],
)
def test_records_that_are_no_sweep_are_refused(bad: np.ndarray) -> None:
    with pytest.raises(SourceError):
        sweep_of(0.0, bad)


@pytest.mark.parametrize("fields", [{"x": ("f4", -1)}, {"x": ("f4", 14)}])
def test_a_field_outside_of_the_record_is_refused(fields: dict[str, tuple[str, int]]) -> None:
    with pytest.raises(SourceError, match="outside"):
        record_type(fields, 16)


@given(stn.arrays(st.sampled_from(["f4", "f8", "u4", "u8", "i8", "u1"]), st.integers(1, 20)))
def test_whatever_the_times_none_is_far_from_the_stamp(times: np.ndarray) -> None:
    found = seconds_after(STAMP_S, times)
    assert found is None or (np.isfinite(found).all() and np.abs(found).max() <= 4.1)
