from __future__ import annotations

import json
import logging
import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from contract.geometry import LatLon
from vehicle_client.frames import GeoOrigin, heading_from_yaw, yaw_of
from vehicle_client.sources.carla_recording import CarlaRecording
from vehicle_client.sources.carla_text import parse_metadata_line, read_carla_ply, right_handed
from vehicle_client.sources.frame import SourceError

PATRAS = GeoOrigin(LatLon(latitude_deg=38.2466, longitude_deg=21.7346), altitude_m=60.0)
HEIGHT_M = 2.4


def scene() -> np.ndarray:
    """Right-handed sensor frame: a road below, a wall ahead to the left, more of it than of the road."""
    rng = np.random.default_rng(0)
    road = np.column_stack([rng.uniform(-15, 15, 900), rng.uniform(-4, 4, 900), rng.normal(-HEIGHT_M, 0.01, 900)])
    wall = np.column_stack([rng.uniform(5, 20, 1200), np.full(1200, 6.0), rng.uniform(-HEIGHT_M, 4, 1200)])
    return np.concatenate([road, wall])


def ply(points: np.ndarray, intensity: bool) -> str:
    rows = np.column_stack([points, np.linspace(0, 1, len(points))]) if intensity else points
    names = ["x", "y", "z", "I"][: rows.shape[1]]
    lines = ["ply", "format ascii 1.0", f"element vertex {len(rows)}", *(f"property float32 {n}" for n in names)]
    return "\n".join([*lines, "end_header", *(" ".join(f"{v:.4f}" for v in row) for row in rows)]) + "\n"


def newer(points: np.ndarray) -> str:
    return ply(points * [1, -1, 1], intensity=True)


def older(points: np.ndarray) -> str:
    """Right, back, down."""
    x, y, z = points.T
    return ply(np.column_stack([-y, -x, -z]), intensity=False)


def metadata(number: int, time_s: float, x: float, yaw_deg: float = 0.0) -> str:
    return (
        f"LidarMeasurement(frame={number}, timestamp={time_s:.6f}, number_of_points=2100), "
        f"Transform(Location(x={x:.6f}, y=-100.400000, z=2.400000), "
        f"Rotation(pitch=0.000000, yaw={yaw_deg:.6f}, roll=0.000000))\n"
    )


def record(folder: Path, text: str, frames: int = 4, first: int = 812) -> Path:
    """The authors' own layout: sweeps, pictures, metadata and steering, nothing of ours."""
    lidar, camera = folder / "ego0/sensor.lidar.ray_cast", folder / "ego0/sensor.camera.rgb"
    lidar.mkdir(parents=True)
    camera.mkdir()
    lines = ""
    for index in range(frames):
        (lidar / f"{first + index:05d}.ply").write_text(text)
        cv2.imwrite(str(camera / f"{first + index:05d}.png"), np.full((4, 8, 3), 50 + index, np.uint8))
        lines += metadata(first + index, 27.0 + index / 30, 110.9 + index * 0.4)
    (lidar / "lidar_metadata.txt").write_text(lines)
    (folder / "ego0/steering_norm.txt").write_text(", ".join(str(0.1 * index) for index in range(frames)))
    return folder


@pytest.mark.parametrize("dialect", [newer, older])
def test_both_dialects_give_the_same_sweep(tmp_path: Path, dialect: object) -> None:
    source = CarlaRecording(record(tmp_path, dialect(scene())))
    frames = list(source)
    assert len(source) == len(frames) == 4
    assert frames[0].points_m == pytest.approx(scene(), abs=6e-5)
    assert frames[0].points_m.dtype == np.float32
    assert (frames[0].intensity is None) == (dialect is older)
    assert source.skipped == 0


def test_intensity_settles_the_dialect_where_the_road_would_mislead(tmp_path: Path) -> None:
    ceiling = scene() * [1, 1, -1]
    (frame, *_) = CarlaRecording(record(tmp_path, newer(ceiling)))
    assert frame.points_m == pytest.approx(ceiling, abs=6e-5)


def test_a_sweep_that_shows_no_road_is_not_guessed_at(tmp_path: Path) -> None:
    far = scene() + np.array([500, 0, 0])
    with pytest.raises(SourceError, match="no road below the sensor"):
        CarlaRecording(record(tmp_path, older(far)))


def test_frames_carry_time_picture_steering_speed_and_pose(tmp_path: Path) -> None:
    frames = list(CarlaRecording(record(tmp_path, newer(scene()))))
    assert [f.stamp_s for f in frames] == pytest.approx([27 + i / 30 for i in range(4)], abs=1e-6)
    assert [int(f.image[0, 0, 0]) for f in frames] == [50, 51, 52, 53]
    # CARLA's 0.1 is 7 degrees to the right.
    assert [f.steering_rad for f in frames] == pytest.approx([-math.radians(7 * i) for i in range(4)])
    assert [f.speed_mps for f in frames] == pytest.approx([12.0] * 4, rel=1e-3)
    # The vehicle's origin lies on the road below the sensor, y turned round.
    assert frames[0].odom_from_vehicle[:3, 3] == pytest.approx([110.9, 100.4, 0.0])


def test_the_georeference_is_asked_for_or_there_is_no_fix(tmp_path: Path) -> None:
    record(tmp_path, newer(scene()))
    assert all(frame.gnss is None for frame in CarlaRecording(tmp_path))
    fix = next(iter(CarlaRecording(tmp_path, origin=PATRAS))).gnss
    # CARLA's y = -100.4 is north of the origin.
    assert PATRAS.enu(fix.position, fix.altitude_m) == pytest.approx([110.9, 100.4, 0.0], abs=1e-6)
    assert fix.heading_rad == pytest.approx(math.pi / 2)


def test_a_turn_to_the_right_is_a_growing_heading(tmp_path: Path) -> None:
    record(tmp_path, newer(scene()), frames=1)
    path = tmp_path / "ego0/sensor.lidar.ray_cast/lidar_metadata.txt"
    path.write_text(metadata(812, 27.0, 0.0, yaw_deg=30))
    (frame,) = CarlaRecording(tmp_path, origin=PATRAS)
    assert frame.gnss.heading_rad == pytest.approx(math.radians(120))
    assert heading_from_yaw(yaw_of(frame.odom_from_vehicle)) == pytest.approx(math.radians(120))


def test_what_is_missing_cut_or_corrupt_is_skipped_with_a_warning_each(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    record(tmp_path, newer(scene()), frames=8)
    lidar, camera = tmp_path / "ego0/sensor.lidar.ray_cast", tmp_path / "ego0/sensor.camera.rgb"
    (lidar / "00813.ply").unlink()
    (lidar / "00814.ply").write_text(newer(scene())[:20_000])
    (lidar / "00815.ply").write_bytes(b"\x00\xff" * 100)
    (lidar / "00816.ply").write_text(newer(scene()).replace("6.0000", "x", 1))
    (camera / "00818.png").write_bytes((camera / "00818.png").read_bytes()[:-20])
    (lidar / "00999.ply").write_text(newer(scene()))
    with (lidar / "lidar_metadata.txt").open("a") as file:
        file.write("LidarMeasurement(frame=820, timest")
    with caplog.at_level(logging.WARNING):
        source = CarlaRecording(tmp_path)
        frames = list(source)
    assert [round((f.stamp_s - 27) * 30) for f in frames] == [0, 5, 6, 7]
    assert [f.image is None for f in frames] == [False, False, True, False]
    assert len(caplog.messages) == source.skipped == 7
    for part in ("frame 813 is missing", "00814.ply", "00815.ply", "00816.ply", "00818.png", "frame 999", "line 9"):
        assert sum(part in message for message in caplog.messages) == 1, part


def test_a_camera_slower_than_the_lidar_gives_each_picture_once(tmp_path: Path) -> None:
    record(tmp_path, newer(scene()), frames=6)
    for number in (812, 814, 815, 817):
        (tmp_path / f"ego0/sensor.camera.rgb/{number:05d}.png").unlink()
    images = [frame.image for frame in CarlaRecording(tmp_path)]
    assert [None if image is None else int(image[0, 0, 0]) for image in images] == [None, 51, None, None, 54, None]


@pytest.mark.parametrize("text", ["0.1, 0.2", "a, b, c, d", "nan, 0, 0, 0", ""])
def test_steering_that_fits_no_frames_is_left_out(tmp_path: Path, text: str) -> None:
    record(tmp_path, newer(scene()))
    (tmp_path / "ego0/steering_norm.txt").write_text(text)
    source = CarlaRecording(tmp_path)
    assert [frame.steering_rad for frame in source] == [0.0] * 4
    assert source.skipped == 1


def test_what_is_no_recording_is_refused_with_what_was_expected(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"expected a recording in CARLA's layout.*lidar_metadata\.txt"):
        CarlaRecording(tmp_path)
    record(tmp_path / "run", newer(scene()))
    with pytest.raises(SourceError, match="ego3"):
        CarlaRecording(tmp_path / "run", ego=3)
    (tmp_path / "run/ego0/sensor.lidar.ray_cast/lidar_metadata.txt").write_text("")
    with pytest.raises(SourceError, match="found none"):
        CarlaRecording(tmp_path / "run")


@pytest.mark.parametrize("text", ["{", "[]", '{"clock": {"start_unix_s": NaN}}', "\x00"])
def test_a_description_that_makes_no_sense_is_refused(tmp_path: Path, text: str) -> None:
    record(tmp_path, newer(scene()))
    (tmp_path / "recording.json").write_text(text)
    with pytest.raises(SourceError, match=r"recording\.json: expected the description"):
        CarlaRecording(tmp_path)


def describe(folder: Path) -> None:
    """A receiver half a metre behind and left of the middle, 1.5 m up, and an inertial unit turned by 90 degrees."""
    sensors = [
        {"type": "sensor.other.gnss", "transform": [{"x": -0.5, "y": -0.4, "z": 1.5}]},
        {"type": "sensor.other.imu", "transform": [{"yaw": 90.0}]},
    ]
    place = {"latitude_deg": 38.2466, "longitude_deg": 21.7346, "altitude_m": 60.0}
    said = {"clock": {"start_unix_s": 1000.0}, "georeference": place, "sensors": sensors}
    (folder / "recording.json").write_text(json.dumps({**said, "enu_from_street": np.eye(4).tolist()}))


def test_fixes_are_moved_from_the_antenna_and_headings_from_the_turned_unit(tmp_path: Path) -> None:
    record(tmp_path, newer(scene()))
    describe(tmp_path)
    # The car looks north, the inertial unit east: its x is the car's right.
    columns = "frame,time_s,latitude_deg,longitude_deg,altitude_m,sd_m,altitude_sd_m\n"
    antenna, altitude_m = PATRAS.geodetic(np.array([5.0 - 0.4, 7.0 - 0.5, 1.5]))
    row = f"813,{27 + 1 / 30},{antenna.latitude_deg!r},{antenna.longitude_deg!r},{altitude_m!r},1.5,3.0\n"
    (tmp_path / "ego0/gnss.csv").write_text(columns + row)
    (tmp_path / "ego0/imu.csv").write_text(f"frame,time_s,compass_rad\n812,27.0,{math.pi / 2}\n")
    frames = list(CarlaRecording(tmp_path))
    assert [frame.gnss is None for frame in frames] == [True, False, True, True]
    fix = frames[1].gnss
    assert fix.heading_rad == pytest.approx(0.0, abs=1e-9) or fix.heading_rad == pytest.approx(2 * math.pi)
    assert PATRAS.enu(fix.position, fix.altitude_m) == pytest.approx([5.0, 7.0, 0.0], abs=1e-5)
    assert (fix.sd_m, fix.altitude_sd_m) == (1.5, 3.0)
    assert frames[0].stamp_s == pytest.approx(1027.0)


def test_lines_of_tables_that_make_no_sense_are_one_warning(tmp_path: Path) -> None:
    record(tmp_path, newer(scene()))
    describe(tmp_path)
    columns = "frame,time_s,latitude_deg,longitude_deg,altitude_m,sd_m,altitude_sd_m\n"
    rows = ["812,27.0,91,0,0,1,1\n", "812,nan,1,1,0,1,1\n", "812,27.0,1,1,0,1,1\n", "813,27.03\n"]
    (tmp_path / "ego0/gnss.csv").write_text(columns + "".join(rows))
    source = CarlaRecording(tmp_path)
    assert source.skipped == 1
    assert [frame.gnss is None for frame in source] == [False, True, True, True]


numbers = st.floats(-1e5, 1e5)


@given(numbers, numbers, numbers, st.floats(-90, 90), numbers, numbers, st.integers(0, 10**9))
def test_a_line_gives_back_what_was_printed(
    x: float, y: float, z: float, pitch: float, yaw: float, roll: float, number: int
) -> None:
    line = (
        f"LidarMeasurement(frame={number}, timestamp={abs(x):f}, number_of_points=1), "
        f"Transform(Location(x={x:f}, y={y:f}, z={z:f}), Rotation(pitch={pitch:f}, yaw={yaw:f}, roll={roll:f}))"
    )
    frame = parse_metadata_line(line)
    assert frame.number == number
    assert frame.time_s == pytest.approx(abs(x), abs=1e-6)
    expected = right_handed(np.array([x, y, z]), pitch, yaw, roll)
    assert frame.world_from_sensor == pytest.approx(expected, abs=1e-6)


@given(st.text(max_size=200))
def test_any_other_line_is_none(line: str) -> None:
    assert parse_metadata_line(line) is None


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.binary(max_size=60), at=st.integers(0, 400))
def test_corrupt_bytes_give_a_sweep_or_a_clear_error(tmp_path: Path, data: bytes, at: int) -> None:
    whole = newer(scene()[:10]).encode()
    path = tmp_path / "00001.ply"
    path.write_bytes(whole[:at] + data + whole[at + len(data) :])
    try:
        sweep = read_carla_ply(path)
    except SourceError:
        return
    assert sweep.raw_m.shape[1] == 3
