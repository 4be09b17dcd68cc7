"""What our own recordings keep beside CARLA's layout: rings, times inside a sweep, yaw rates, stamps of fixes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.unit.simulator.recording_frames import GNSS, IMU, LIDAR, PERIOD_S, ego_frame, header, write_recording
from vehicle_client.sources.carla_recording import CarlaRecording
from vehicle_client.sources.opening import open_source

NAMES = (LIDAR, GNSS, IMU)
FRAMES = 4
SWEEPS = "ego0/sensor.lidar.ray_cast"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    write_recording(tmp_path / "run", FRAMES, egos=1, names=NAMES)
    return tmp_path / "run"


def made(index: int, name: object) -> object:
    return next(r for r in ego_frame(index, names=NAMES).readings if r.sensor == name)


def test_rings_and_times_come_from_the_labels(run: Path) -> None:
    for index, frame in enumerate(CarlaRecording(run)):
        sweep = made(index, LIDAR).sweep
        assert frame.ring.tolist() == sweep.ring.tolist()
        assert frame.point_time_s.tolist() == sweep.time_offset_s.tolist()


def test_yaw_rates_and_stamps_of_fixes_come_from_the_tables(run: Path) -> None:
    start_s = header().start_ns / 1e9
    for index, frame in enumerate(CarlaRecording(run)):
        assert [m.yaw_rate_rps for m in frame.motions] == [made(index, IMU).gyroscope_radps[2]]
        assert frame.motions[0].stamp_s == pytest.approx(start_s + index * PERIOD_S, abs=1e-6)
        assert frame.gnss.stamp_s == pytest.approx(start_s + index * PERIOD_S, abs=1e-6)


def test_labels_that_are_missing_cut_or_of_another_sweep_leave_the_sweep(run: Path) -> None:
    labels = sorted((run / SWEEPS / "labels").glob("*.npz"))
    labels[0].unlink()
    labels[1].write_bytes(labels[1].read_bytes()[:100])
    np.savez(labels[2], ring=np.zeros(3, np.uint16), time_offset_s=np.zeros(3, np.float32))
    source = CarlaRecording(run)
    assert [frame.ring is None for frame in source] == [True, True, True, False]
    assert source.skipped == 2


def test_sweeps_whose_times_do_not_rise_are_left_out(run: Path) -> None:
    path = run / SWEEPS / "lidar_metadata.txt"
    lines = path.read_text().splitlines()
    lines[2] = lines[2].replace("timestamp=0.2", "timestamp=0.0")
    path.write_text("\n".join(lines))
    source = CarlaRecording(run)
    assert len(list(source)) == FRAMES - 1
    assert source.skipped == 1


def test_folder_and_mcap_of_one_vehicle_are_the_same_drive(run: Path) -> None:
    folder, mcap = list(open_source(run)), list(open_source(run / "ego0.mcap"))
    assert len(folder) == len(mcap) == FRAMES
    for one, other in zip(folder, mcap, strict=True):
        assert one.stamp_s == pytest.approx(other.stamp_s, abs=1e-6)
        assert one.points_m == pytest.approx(other.points_m, abs=6e-5)
        assert one.ring.tolist() == other.ring.tolist()
        assert one.odom_from_vehicle == pytest.approx(other.odom_from_vehicle, abs=1e-9)
        assert one.gnss.heading_rad == pytest.approx(other.gnss.heading_rad, abs=1e-6)
        assert one.gnss.stamp_s == pytest.approx(other.gnss.stamp_s, abs=1e-6)
        assert one.steering_rad == pytest.approx(other.steering_rad, abs=1e-6)
        assert [m.yaw_rate_rps for m in one.motions] == [
            m.yaw_rate_rps for m in other.motions if m.yaw_rate_rps is not None
        ]
