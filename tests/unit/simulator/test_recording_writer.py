from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from simulator.readings import SensorName
from simulator.recording.files import RecordingError
from simulator.recording.header import sensor_folders
from simulator.recording.writer import RecordingWriter
from tests.unit.simulator.recording_frames import (
    CAMERA,
    FIRST_FRAME,
    GNSS,
    IMU,
    LIDAR,
    MOUNTED,
    SEMANTIC_CAMERA,
    SEMANTIC_LIDAR,
    ego_frame,
    header,
    street_from_vehicle,
    sweep,
    write_recording,
)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recording") / "run"
    write_recording(folder)
    return folder


def digests(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def table(path: Path) -> np.ndarray:
    return np.atleast_1d(np.genfromtxt(path, delimiter=",", names=True))


def test_the_same_frames_give_the_same_bytes(recording: Path, tmp_path: Path) -> None:
    write_recording(tmp_path / "again")
    assert digests(tmp_path / "again") == digests(recording)


def test_a_run_holds_the_authors_files_and_nothing_unfinished(recording: Path) -> None:
    for name in (
        f"{LIDAR.type}/{FIRST_FRAME:05d}.ply",
        f"{LIDAR.type}/lidar_metadata.txt",
        f"{CAMERA.type}/{FIRST_FRAME:05d}.png",
        f"{CAMERA.type}/camera_metadata.txt",
        "steering_norm.txt",
        "steering_true.txt",
    ):
        assert (recording / "ego0" / name).is_file(), name
        assert (recording / "ego1" / name).is_file(), name
    assert not list(recording.rglob("*.part"))


def test_a_sweep_is_left_handed_and_its_labels_follow_its_points(recording: Path) -> None:
    made = sweep(0)
    rows = np.loadtxt(recording / f"ego0/{LIDAR.type}/{FIRST_FRAME:05d}.ply", skiprows=8)
    assert rows[:, 0] == pytest.approx(made.points_m[:, 0], abs=6e-5)
    assert rows[:, 1] == pytest.approx(-made.points_m[:, 1], abs=6e-5)
    assert rows[:, 2] == pytest.approx(made.points_m[:, 2], abs=6e-5)
    assert rows[:, 3] == pytest.approx(made.intensity, abs=6e-5)
    with np.load(recording / f"ego0/{LIDAR.type}/labels/{FIRST_FRAME:05d}.npz") as labels:
        for name in ("surface", "obstacle_id", "mover_id", "ring", "time_offset_s"):
            assert labels[name].tolist() == getattr(made, name).tolist(), name


def test_a_semantic_sweep_names_what_it_hit(recording: Path) -> None:
    made = sweep(0)
    rows = np.loadtxt(recording / f"ego0/{SEMANTIC_LIDAR.type}/{FIRST_FRAME:05d}.ply", skiprows=10)
    assert rows[:, 3] == pytest.approx(made.cos_incidence, abs=6e-5)
    on_obstacle = (made.obstacle_id > 0) & (made.mover_id == 0)
    assert rows[on_obstacle, 4].tolist() == (1_000_000 + made.obstacle_id[on_obstacle]).tolist()
    assert rows[made.surface == 8, 5].tolist() == [14] * int((made.surface == 8).sum())


def test_metadata_is_carlas_text_of_the_exact_pose(recording: Path) -> None:
    lines = (recording / f"ego1/{LIDAR.type}/lidar_metadata.txt").read_text().splitlines()
    assert len(lines) == 4
    measurement, _, transform = lines[2].partition("), ")
    assert measurement == f"LidarMeasurement(frame={FIRST_FRAME + 2}, timestamp=0.200000, number_of_points=400"
    assert transform.startswith("Transform(Location(x=")
    position = (street_from_vehicle(2, ego=1) @ MOUNTED[LIDAR])[:3, 3]
    x, y, z = (float(part.split("=")[1].rstrip(")")) for part in transform.split("Rotation")[0][19:].split(", ")[:3])
    assert (x, -y, z) == pytest.approx(tuple(position), abs=1e-6)
    camera = (recording / f"ego0/{CAMERA.type}/camera_metadata.txt").read_text().splitlines()[0]
    assert camera.startswith(f"Image(frame={FIRST_FRAME}, timestamp=0.000000, size=48x24), Transform(")


def test_steering_to_the_left_is_negative_and_seventy_degrees_are_one(recording: Path) -> None:
    norm = [float(v) for v in (recording / "ego0/steering_norm.txt").read_text().split(", ")]
    true = [float(v) for v in (recording / "ego0/steering_true.txt").read_text().split(", ")]
    assert len(norm) == 4
    assert np.radians(true) == pytest.approx([-0.05, -0.04, -0.03, -0.02])
    assert np.array(norm) * 70 == pytest.approx(true)


def test_exact_poses_and_odometry_keep_every_digit(recording: Path) -> None:
    for name, field in (("poses", "street_from_vehicle"), ("odometry", "odom_from_vehicle")):
        rows = table(recording / f"ego0/{name}.csv")
        for index, row in enumerate(rows):
            expected = getattr(ego_frame(index), field)
            assert row["frame"] == FIRST_FRAME + index
            assert [row["x_m"], row["y_m"], row["z_m"]] == expected[:3, 3].tolist()
            rotation = Rotation.from_quat([row[q] for q in ("qx", "qy", "qz", "qw")]).as_matrix()
            assert rotation == pytest.approx(expected[:3, :3], abs=1e-12)


def test_fixes_and_inertia_are_tables(recording: Path) -> None:
    fix = next(r for r in ego_frame(1).readings if r.sensor == GNSS)
    row = table(recording / "ego0/gnss.csv")[1]
    assert (row["latitude_deg"], row["longitude_deg"]) == (fix.position.latitude_deg, fix.position.longitude_deg)
    assert (row["altitude_m"], row["sd_m"], row["altitude_sd_m"]) == (fix.altitude_m, 1.5, 3.0)
    inertia = next(r for r in ego_frame(1).readings if r.sensor == IMU)
    row = table(recording / "ego0/imu.csv")[1]
    assert [row[f"accelerometer_{a}_mps2"] for a in "xyz"] == inertia.accelerometer_mps2.tolist()
    assert row["compass_rad"] == inertia.compass_rad


def test_a_semantic_picture_holds_the_tags_in_red(recording: Path) -> None:
    picture = next(r for r in ego_frame(0).readings if r.sensor == SEMANTIC_CAMERA)
    path = recording / f"ego0/{SEMANTIC_CAMERA.type}/{FIRST_FRAME:05d}.png"
    assert cv2.imread(path, cv2.IMREAD_UNCHANGED)[..., 2].tolist() == picture.pixels.tolist()


def test_the_recording_says_how_it_was_made(recording: Path) -> None:
    said = json.loads((recording / "recording.json").read_text())
    assert said["seed"] == 5
    assert said["clock"]["start"] == "2026-05-04T12:00:00+00:00"
    assert said["georeference"]["latitude_deg"] == 38.2466
    assert [s["type"] for s in said["sensors"]] == [name.type for name in MOUNTED]
    assert said["egos"][1] == {"folder": "ego1", "frames": 4, "first": FIRST_FRAME, "last": FIRST_FRAME + 3}
    rows = json.loads((recording / "obstacles.json").read_text())
    assert [(row["change"], row["from_s"]) for row in rows] == [("initial", 0.0), ("grown", 0.2), ("removed", 0.3)]
    assert rows[0]["position"]["latitude_deg"] == pytest.approx(38.2467, abs=1e-4)


def test_an_interrupted_recording_can_be_told_from_a_finished_one(tmp_path: Path) -> None:
    def run() -> None:
        with RecordingWriter(tmp_path / "run", header(), egos=1) as recording:
            recording.write(0, ego_frame(0))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run()
    assert not (tmp_path / "run/recording.json").exists()
    assert not (tmp_path / "run/ego0.mcap").exists()
    assert (tmp_path / "run/ego0.mcap.part").exists()
    assert len(table(tmp_path / "run/ego0/poses.csv")) == 1


def test_a_folder_that_holds_something_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(RecordingError, match="empty folder"):
        RecordingWriter(tmp_path, header(), egos=1)
    with pytest.raises(RecordingError, match="empty folder"):
        RecordingWriter(tmp_path / "notes.txt", header(), egos=1)


def test_frames_come_in_order_and_from_announced_sensors(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "run", header((LIDAR,)), egos=1, mcap=False) as recording:
        recording.write(0, ego_frame(1, names=(LIDAR,)))
        with pytest.raises(RecordingError, match="frame 7 came after frame 8"):
            recording.write(0, ego_frame(0, names=(LIDAR,)))
        with pytest.raises(RecordingError, match=r"sensor.camera.rgb 'front' is not among the sensors"):
            recording.write(0, ego_frame(2, names=(LIDAR, CAMERA)))
    assert json.loads((tmp_path / "run/recording.json").read_text())["egos"][0]["frames"] == 1


def test_two_sensors_of_a_type_are_told_apart_by_their_roles() -> None:
    folders = sensor_folders([{"type": "sensor.camera.rgb", "role_name": role} for role in ("left", "right")])
    assert list(folders.values()) == ["sensor.camera.rgb.left", "sensor.camera.rgb.right"]
    assert sensor_folders([{"type": "sensor.camera.rgb", "role_name": "left"}]) == {
        SensorName("sensor.camera.rgb", "left"): "sensor.camera.rgb"
    }
    with pytest.raises(RecordingError, match="different role_names"):
        sensor_folders([{"type": "sensor.camera.rgb", "role_name": "left"}] * 2)
    for bad in ("../up", "a/b", "", "sensor.camera.rgb\n"):
        with pytest.raises(RecordingError, match="cannot name a folder"):
            sensor_folders([{"type": bad}])


def test_two_receivers_have_a_table_each(tmp_path: Path) -> None:
    names = (SensorName(GNSS.type, "front"), SensorName(GNSS.type, "back"))
    sensors = [{"type": name.type, "role_name": name.role} for name in names]
    fix = next(r for r in ego_frame(0).readings if r.sensor == GNSS)
    frame = replace(ego_frame(0), readings=tuple(replace(fix, sensor=name) for name in names))
    with RecordingWriter(tmp_path / "run", replace(header(), sensors=sensors), egos=1) as recording:
        recording.write(0, frame)
    assert len(table(tmp_path / "run/ego0/gnss.front.csv")) == 1
    assert len(table(tmp_path / "run/ego0/gnss.back.csv")) == 1


def test_a_start_without_its_offset_is_refused() -> None:
    with pytest.raises(RecordingError, match="offset from UTC"):
        replace(header(), start=datetime(2026, 5, 4))
