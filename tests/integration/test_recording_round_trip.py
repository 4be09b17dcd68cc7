"""What the simulator records, the vehicle reads: the two never import each other."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from tests.unit.simulator.recording_frames import (
    CAMERA,
    GEOREFERENCE,
    GNSS,
    IMU,
    LIDAR,
    PERIOD_S,
    SEMANTIC_LIDAR,
    ego_frame,
    header,
    write_recording,
)
from vehicle_client.frames import yaw_from_heading, yaw_of
from vehicle_client.sources.carla_recording import CarlaRecording
from vehicle_client.sources.frame import LidarFrame

FRAMES = 5
SENSORS = (LIDAR, CAMERA, GNSS, IMU)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("round_trip") / "run"
    write_recording(folder, FRAMES, egos=2, names=SENSORS, mcap=False)
    return folder


@pytest.fixture(scope="module", params=[0, 1])
def ego(request: pytest.FixtureRequest) -> int:
    return int(request.param)


@pytest.fixture(scope="module")
def frames(run: Path, ego: int) -> list[LidarFrame]:
    source = CarlaRecording(run, ego)
    found = list(source)
    assert len(source) == len(found) == FRAMES
    assert source.skipped == 0
    return found


def test_sweeps_come_back_to_the_files_precision(frames: list[LidarFrame], ego: int) -> None:
    for index, frame in enumerate(frames):
        made = next(r for r in ego_frame(index, ego).readings if r.sensor == LIDAR).sweep
        assert frame.points_m == pytest.approx(made.points_m, abs=6e-5)
        assert frame.intensity == pytest.approx(made.intensity, abs=6e-5)


def test_pictures_come_back_exactly(frames: list[LidarFrame], ego: int) -> None:
    for index, frame in enumerate(frames):
        made = next(r for r in ego_frame(index, ego).readings if r.sensor == CAMERA).pixels
        assert frame.image.tolist() == made.tolist()


def test_state_comes_back(frames: list[LidarFrame], ego: int) -> None:
    start_s = header().start.timestamp()
    for index, frame in enumerate(frames):
        made = ego_frame(index, ego)
        assert frame.stamp_s == pytest.approx(start_s + index * PERIOD_S, abs=2e-6)
        assert frame.steering_rad == pytest.approx(made.steering_rad, abs=1e-12)
        assert frame.speed_mps == made.speed_mps
        assert frame.odom_from_vehicle == pytest.approx(made.odom_from_vehicle, abs=1e-9)


def test_without_odometry_the_pose_is_that_of_the_transforms_to_a_micrometre(run: Path, ego: int) -> None:
    path = run / f"ego{ego}/odometry.csv"
    text = path.read_text()
    path.unlink()
    try:
        frames = list(CarlaRecording(run, ego))
    finally:
        path.write_text(text)
    for index, frame in enumerate(frames):
        assert frame.odom_from_vehicle == pytest.approx(ego_frame(index, ego).street_from_vehicle, abs=1e-6)


def test_fixes_lie_at_the_vehicles_origin(frames: list[LidarFrame], ego: int) -> None:
    for index, frame in enumerate(frames):
        enu_from_vehicle = ego_frame(index, ego).enu_from_vehicle
        enu = GEOREFERENCE.enu_from_geodetic(frame.gnss.position, frame.gnss.altitude_m)
        assert enu == pytest.approx(enu_from_vehicle[:3, 3], abs=1e-4)
        turn = yaw_from_heading(frame.gnss.heading_rad) - yaw_of(enu_from_vehicle)
        assert math.remainder(turn, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)
        assert (frame.gnss.sd_m, frame.gnss.altitude_sd_m) == (1.5, 3.0)


def test_a_recording_of_the_semantic_lidar_alone_gives_points_without_intensity(tmp_path: Path) -> None:
    write_recording(tmp_path / "run", 2, egos=1, names=(SEMANTIC_LIDAR,), mcap=False)
    frames = list(CarlaRecording(tmp_path / "run"))
    made = next(r for r in ego_frame(1).readings if r.sensor == SEMANTIC_LIDAR).sweep
    assert frames[1].points_m == pytest.approx(made.points_m, abs=6e-5)
    assert frames[1].intensity is None
    assert frames[1].image is None
    # The place is known from recording.json although there was no receiver.
    enu = GEOREFERENCE.enu_from_geodetic(frames[1].gnss.position, frames[1].gnss.altitude_m)
    assert enu == pytest.approx(ego_frame(1).enu_from_vehicle[:3, 3], abs=1e-5)


def test_an_unfinished_recording_reads_to_where_it_ended(tmp_path: Path) -> None:
    write_recording(tmp_path / "run", 4, egos=1, names=SENSORS, mcap=False)
    folder = tmp_path / "run/ego0/sensor.lidar.ray_cast"
    (tmp_path / "run/recording.json").unlink()
    (folder / "00010.ply").rename(folder / "00010.ply.part")
    text = (folder / "lidar_metadata.txt").read_text().splitlines(keepends=True)
    (folder / "lidar_metadata.txt").write_text("".join(text[:3]) + text[3][:30])
    source = CarlaRecording(tmp_path / "run")
    assert len(list(source)) == 3
    assert source.skipped == 1
    assert np.isfinite([frame.stamp_s for frame in source]).all()
