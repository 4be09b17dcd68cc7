from __future__ import annotations

import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from contract.geometry import LatLon
from tests.unit.vehicle_client.sources.kitti_files import (
    HEADING_YAW_RAD,
    SPEED_MPS,
    START_S,
    cloud,
    oxts_line,
    stamp,
    write_odometry,
    write_raw,
)
from vehicle_client.frames import GeoOrigin
from vehicle_client.sources.frame import SourceError
from vehicle_client.sources.kitti_odometry import KittiOdometry
from vehicle_client.sources.kitti_raw import KittiRaw
from vehicle_client.sources.kitti_text import numbers_of, stamp_of
from vehicle_client.sources.opening import open_source

KARLSRUHE = GeoOrigin(LatLon(latitude_deg=49.015, longitude_deg=8.4342), 116.0)


def test_a_raw_drive_gives_sweeps_pictures_and_stamps(tmp_path: Path) -> None:
    source = KittiRaw(write_raw(tmp_path, KARLSRUHE))
    frames = list(source)
    assert len(source) == len(frames) == 4
    assert [f.stamp_s for f in frames] == pytest.approx([START_S + 0.1 * i for i in range(4)], abs=1e-6)
    assert frames[2].points_m.tolist() == cloud(2)[:, :3].tolist()
    assert frames[2].intensity.tolist() == cloud(2)[:, 3].tolist()
    assert [int(f.image[0, 0, 0]) for f in frames] == [40, 41, 42, 43]
    assert frames[1].image_stamp_s == pytest.approx(START_S + 0.1, abs=1e-6)
    assert source.skipped == 0


def test_a_drive_as_it_was_before_synchronisation_has_sweeps_as_text_and_many_fixes(tmp_path: Path) -> None:
    drive = write_raw(tmp_path, KARLSRUHE, frames=3)
    for path in (drive / "velodyne_points/data").glob("*.bin"):
        rows = np.fromfile(path, "<f4").reshape(-1, 4)
        path.with_suffix(".txt").write_text("\n".join(" ".join(f"{v:.3f}" for v in row) for row in rows) + "\n")
        path.unlink()
    (drive / "velodyne_points/data/0000000001.txt").write_text("1.0 2.0 3.0")
    (drive / "oxts/timestamps.txt").write_text("".join(stamp(START_S + 0.01 * i) for i in range(21)))
    for index in range(21):
        (drive / f"oxts/data/{index:010d}.txt").write_text(oxts_line(KARLSRUHE, index))
    source = open_source(drive)
    first, last = source
    assert first.points_m == pytest.approx(cloud(0)[:, :3], abs=6e-4)
    assert (len(first.motions), len(last.motions)) == (1, 20)
    assert last.gnss.stamp_s == pytest.approx(START_S + 0.2, abs=1e-6)
    assert source.skipped == 1


def test_its_fix_is_that_of_the_road_below_the_lidar(tmp_path: Path) -> None:
    frame = next(iter(KittiRaw(write_raw(tmp_path, KARLSRUHE))))
    # The LiDAR is 0.81 m before the unit, 0.32 m to its right and 0.8 m higher; the road 1.73 m below the LiDAR.
    forward, left = (
        np.array([math.cos(HEADING_YAW_RAD), math.sin(HEADING_YAW_RAD)]),
        np.array([-math.sin(HEADING_YAW_RAD), math.cos(HEADING_YAW_RAD)]),
    )
    expected = [*(0.81 * forward - 0.32 * left), 0.8 - 1.73]
    assert KARLSRUHE.enu(frame.gnss.position, frame.gnss.altitude_m) == pytest.approx(expected, abs=1e-6)
    assert frame.gnss.heading_rad == pytest.approx(math.pi / 2 - HEADING_YAW_RAD)
    assert frame.gnss.course_rad == pytest.approx(math.pi / 2 - HEADING_YAW_RAD)
    assert (frame.gnss.sd_m, frame.gnss.speed_mps) == (0.05, pytest.approx(SPEED_MPS))


def test_motions_bring_speed_and_yaw_rate(tmp_path: Path) -> None:
    frames = list(KittiRaw(write_raw(tmp_path, KARLSRUHE)))
    assert [len(f.motions) for f in frames] == [1, 1, 1, 1]
    assert (frames[1].motions[0].speed_mps, frames[1].motions[0].yaw_rate_rps) == (SPEED_MPS, 0.1)
    assert frames[1].speed_mps == pytest.approx(SPEED_MPS)
    assert frames[1].odom_from_vehicle is None


def test_a_raw_drive_without_the_rest_is_sweeps_alone(tmp_path: Path) -> None:
    drive = write_raw(tmp_path, KARLSRUHE)
    (drive / "image_02/timestamps.txt").unlink()
    (drive / "oxts/timestamps.txt").unlink()
    frames = list(KittiRaw(drive))
    assert [(f.image, f.gnss, f.motions) for f in frames] == [(None, None, ())] * 4


def test_what_is_cut_of_a_raw_drive_is_skipped_and_counted(tmp_path: Path) -> None:
    drive = write_raw(tmp_path, KARLSRUHE, frames=6)
    (drive / "velodyne_points/data/0000000001.bin").write_bytes(b"1234567")
    (drive / "oxts/data/0000000002.txt").write_text("49.0 8.4")
    (drive / "image_02/data/0000000003.png").write_bytes(b"no picture")
    stamps = (drive / "velodyne_points/timestamps.txt").read_text().splitlines()
    stamps[4] = "2011-99-26 13:02"
    (drive / "velodyne_points/timestamps.txt").write_text("\n".join(stamps))
    source = KittiRaw(drive)
    frames = list(source)
    assert [round((f.stamp_s - START_S) * 10) for f in frames] == [0, 2, 3, 5]
    assert [f.image is None for f in frames] == [False, False, True, False]
    assert frames[1].gnss.stamp_s == pytest.approx(START_S + 0.1, abs=1e-6)
    assert source.skipped == 4


def test_an_odometry_sequence_has_poses_of_the_vehicle(tmp_path: Path) -> None:
    source = KittiOdometry(write_odometry(tmp_path), start_s=1000.0)
    frames = list(source)
    assert len(source) == len(frames) == 4
    assert [f.stamp_s for f in frames] == pytest.approx([1000 + 0.1 * i for i in range(4)])
    # The camera's z is the car's x, its x to the right is minus the car's y.
    for index, frame in enumerate(frames):
        assert frame.odom_from_vehicle[:3, 3] == pytest.approx([0.8 * index, -0.02 * index, 0.0], abs=1e-9)
        assert frame.odom_from_vehicle[:3, :3] == pytest.approx(np.eye(3), abs=1e-9)
        assert int(frame.image[0, 0, 0]) == 40 + index
    assert source.skipped == 0


def test_a_sequence_without_poses_or_with_bad_ones_goes_on(tmp_path: Path) -> None:
    sequence = write_odometry(tmp_path)
    (tmp_path / "poses/07.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\nnan nan\n")
    source = KittiOdometry(sequence)
    assert [f.odom_from_vehicle is None for f in source] == [False, True, True, True]
    assert source.skipped == 1
    (tmp_path / "poses/07.txt").unlink()
    assert [f.odom_from_vehicle for f in KittiOdometry(sequence)] == [None] * 4


def test_stamps_that_do_not_rise_leave_their_sweeps_out(tmp_path: Path) -> None:
    sequence = write_odometry(tmp_path, frames=6)
    (sequence / "times.txt").write_text("0\n0.1\n0.1\n0.05\nx\n0.5\n")
    source = KittiOdometry(sequence)
    assert [f.stamp_s for f in source] == pytest.approx([0, 0.1, 0.5])
    assert source.skipped == 3


@pytest.mark.parametrize("source", [KittiRaw, KittiOdometry])
def test_what_is_no_such_drive_is_refused(tmp_path: Path, source: type) -> None:
    with pytest.raises(SourceError, match=str(tmp_path)):
        source(tmp_path)


@given(st.text(max_size=60))
def test_any_line_is_a_time_or_none(line: str) -> None:
    found = stamp_of(line)
    assert found is None or math.isfinite(found)


@given(st.lists(st.floats(), max_size=5), st.integers(0, 5))
def test_numbers_are_as_many_as_asked_for_and_finite(values: list[float], count: int) -> None:
    found = numbers_of(" ".join(map(repr, values)), count)
    good = len(values) == count and all(map(math.isfinite, values))
    assert (found is not None) == good


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_whatever_is_corrupt_stamps_rise_and_nothing_else_is_raised(tmp_path: Path, data: st.DataObject) -> None:
    shutil.rmtree(tmp_path / "drive", ignore_errors=True)
    drive = write_raw(tmp_path / "drive", KARLSRUHE, frames=3)
    files = sorted(p for p in drive.rglob("*") if p.is_file())
    for _ in range(data.draw(st.integers(1, 4))):
        path = data.draw(st.sampled_from(files))
        corrupt = bytearray(path.read_bytes())
        at = data.draw(st.integers(0, max(0, len(corrupt) - 1)))
        corrupt[at : at + 8] = data.draw(st.binary(max_size=12))
        path.write_bytes(corrupt)
    try:
        stamps = [frame.stamp_s for frame in KittiRaw(drive)]
    except SourceError:
        return
    assert all(np.diff(stamps) > 0)
