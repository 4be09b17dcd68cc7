"""A car's calibration file: what it says, and what is refused."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from vehicle_client.ar.camera import project
from vehicle_client.frames import apply
from vehicle_client.sensing.calibration_file import CalibrationError, read_calibration
from vehicle_client.sensing.deskew import Spin
from vehicle_client.sensing.time_alignment import SensorDelays

DOCS = Path(__file__).parents[4] / "docs"
LIDAR = '[lidar]\nsensor = "x"\nplace_m = [0, 0, 1.7]\n'
CAMERA = (
    "[camera]\nplace_m = [1, 0, 1.2]\nwidth_px = 640\nheight_px = 480\nfocal_px = [500, 500]\ncentre_px = [320, 240]\n"
)


def written(folder: Path, text: str) -> Path:
    path = folder / "car.toml"
    path.write_text(text)
    return path


def test_the_example_says_what_its_comments_say() -> None:
    car = read_calibration(DOCS / "examples" / "calibration.toml")
    assert car.vehicle.sensor == "hdl-64"
    assert car.vehicle.sensor_height_m == 1.73
    assert car.delays == SensorDelays(0.095, 0.03, 0.01)
    assert car.spin == Spin(10.0, clockwise=False, end_azimuth_rad=math.pi)
    assert car.antenna_m.tolist() == [-1.45, 0.0, 1.21]
    assert car.camera is not None
    assert (car.camera.width_px, car.camera.height_px) == (1242, 375)


def test_every_entry_of_the_example_is_explained() -> None:
    entries = re.findall(r"^(\w+) =", (DOCS / "examples" / "calibration.toml").read_text(), re.MULTILINE)
    explained = (DOCS / "calibration.md").read_text()
    assert [entry for entry in entries if entry not in explained] == []


def test_the_least_file_is_a_lidar(tmp_path: Path) -> None:
    car = read_calibration(written(tmp_path, LIDAR))
    assert car.camera is None
    assert car.spin is None
    assert car.vehicle.vehicle_from_sensor[:3, :3] == pytest.approx(np.eye(3))


def test_a_sensor_with_its_nose_down_sees_the_road_ahead_higher(tmp_path: Path) -> None:
    car = read_calibration(written(tmp_path, LIDAR + "pitch_deg = 2\nyaw_deg = 90\n"))
    straight_out = apply(car.vehicle.vehicle_from_sensor, np.array([10.0, 0.0, 0.0]))
    down_m = 10 * math.sin(math.radians(2))
    assert straight_out == pytest.approx([0.0, 10 * math.cos(math.radians(2)), 1.7 - down_m])


def test_a_camera_that_looks_ahead_has_what_is_left_on_the_left_and_what_is_low_below(tmp_path: Path) -> None:
    car = read_calibration(written(tmp_path, LIDAR + CAMERA))
    assert car.camera is not None
    pixels, _ = project(car.camera, np.array([[11.0, 1.0, 1.2], [11.0, 0.0, 0.2]]))
    assert pixels == pytest.approx(np.array([[270.0, 240.0], [320.0, 290.0]]))


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "lidar: missing"),
        ('[lidar]\nsensor = "x"\n', "lidar.place_m: missing"),
        (LIDAR + "height = 2\n", "lidar.height: no such entry"),
        (LIDAR + "[gps]\n", "gps: no such entry"),
        (LIDAR.replace("1.7", "nan"), "lidar.place_m.2"),
        (LIDAR.replace("1.7", "1700"), "lidar.place_m.2"),
        (LIDAR.replace("[0, 0, 1.7]", "[0, 1.7]"), "lidar.place_m.2: missing"),
        (LIDAR.replace('"x"', '"a b"'), "lidar.sensor"),
        (LIDAR + "pitch_deg = true\n", "lidar.pitch_deg"),
        (LIDAR + '[lidar.spin]\nrate_hz = 10\ndirection = "left"\n', "lidar.spin.direction"),
        (LIDAR + "[lidar.spin]\nrate_hz = 0\n", "lidar.spin"),
        (LIDAR + CAMERA.replace("[500, 500]", "[0, 500]"), "camera.focal_px.0"),
        (LIDAR + CAMERA.replace("640", "6.5"), "camera.width_px"),
        (LIDAR + "[delays_s]\ngnss = 95\n", "delays_s.gnss"),
        ("lidar = [", "not TOML"),
        (LIDAR + "\x00", "not TOML"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_line_that_names_it(tmp_path: Path, text: str, complaint: str) -> None:
    with pytest.raises(CalibrationError, match=re.escape(complaint)) as refused:
        read_calibration(written(tmp_path, text))
    assert "car.toml: " in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_missing_file_and_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match="cannot be read"):
        read_calibration(tmp_path / "none.toml")
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(CalibrationError, match="not TOML"):
        read_calibration(tmp_path / "bytes.toml")
