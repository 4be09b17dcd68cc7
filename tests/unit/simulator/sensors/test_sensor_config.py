"""`sensors.json`: the authors' form, CARLA's defaults, and what is refused."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from simulator.readings import SensorName
from simulator.sensors.camera import CameraModel
from simulator.sensors.gnss import CarlaGnss, GnssModel
from simulator.sensors.imu import ImuModel
from simulator.sensors.lidar import LidarModel
from simulator.sensors.lidar_presets import LIDAR_PRESETS, carla_default
from simulator.sensors.sensor_config import SensorConfigError, load_sensors, read_sensors
from simulator.sensors.sensor_rigs import RIGS, paper_sensors_json, sensor_rig

LIDAR = {"type": "sensor.lidar.ray_cast", "role_name": "lidar"}


def only(**entry: object) -> object:
    return read_sensors({"sensors": [entry]}).sensors[0].model


def test_the_papers_file_reads_back_as_the_papers_values(tmp_path: Path) -> None:
    (tmp_path / "sensors.json").write_text(paper_sensors_json())
    camera, lidar, gnss, imu = load_sensors(tmp_path / "sensors.json").sensors
    assert lidar.model == LidarModel()
    assert (lidar.tick_s, lidar.name) == (1 / 30, SensorName("sensor.lidar.ray_cast", "lidar"))
    assert isinstance(camera.model, CameraModel)
    assert (camera.model.width_px, camera.model.height_px) == (1024, 512)
    assert math.degrees(camera.model.horizontal_fov_rad) == pytest.approx(100)
    assert camera.vehicle_from_sensor[:3, 3].tolist() == lidar.vehicle_from_sensor[:3, 3].tolist() == [0, 0, 2.4]
    assert (gnss.model, imu.model) == (CarlaGnss(), ImuModel())
    assert [gnss.tick_s, imu.tick_s] == [0, 0]


def test_what_is_left_out_has_carlas_default() -> None:
    assert only(**LIDAR, transform=[{"z": 2.4}]) == carla_default()
    camera = only(type="sensor.camera.rgb", role_name="rgb")
    assert isinstance(camera, CameraModel)
    assert (camera.width_px, camera.height_px, math.degrees(camera.horizontal_fov_rad)) == (800, 600, pytest.approx(90))
    semantic = only(type="sensor.lidar.ray_cast_semantic", role_name="s")
    assert isinstance(semantic, LidarModel)
    assert (semantic.channels, semantic.range_m, semantic.range_sd_m) == (32, 10.0, 0.0)


def test_attributes_may_be_text_as_carlas_blueprints_take_them() -> None:
    text = only(**LIDAR, channels="64", range="100.0", points_per_second="800000", dropoff_general_rate="0.1")
    number = only(**LIDAR, channels=64, range=100, points_per_second=800_000, dropoff_general_rate=0.1)
    assert text == number


def test_a_camera_looks_ahead_and_a_turned_one_to_the_right() -> None:
    for yaw, ahead in ((0.0, [1, 0, 0]), (90.0, [0, -1, 0])):
        camera = only(type="sensor.camera.rgb", role_name="c", transform=[{"x": 0.5, "y": 0.2, "z": 2.4, "yaw": yaw}])
        assert isinstance(camera, CameraModel)
        assert camera.vehicle_from_camera[:3, 2] == pytest.approx(ahead)  # the optical axis
        assert camera.vehicle_from_camera[:3, 1] == pytest.approx([0, 0, -1])  # rows of pixels go down
        assert camera.vehicle_from_camera[:3, 3] == pytest.approx([0.5, -0.2, 2.4])


def test_mountings_agree_with_carlas_own_matrix() -> None:
    carla = pytest.importorskip("carla")
    place = {"x": 1.0, "y": -2.0, "z": 3.0, "roll": 10.0, "pitch": -20.0, "yaw": 130.0}
    theirs = carla.Transform(
        carla.Location(place["x"], place["y"], place["z"]),
        carla.Rotation(pitch=place["pitch"], yaw=place["yaw"], roll=place["roll"]),
    )
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    ours = read_sensors({"sensors": [{**LIDAR, "transform": [place]}]}).sensors[0].vehicle_from_sensor
    assert ours == pytest.approx(mirror @ np.array(theirs.get_matrix()) @ mirror, abs=1e-6)


def test_noise_fields_reach_their_sensors() -> None:
    gnss = only(type="sensor.other.gnss", role_name="g", noise_lat_stddev=1e-6, noise_lon_bias="2e-6", noise_alt_bias=3)
    assert gnss == CarlaGnss(latitude_sd_deg=1e-6, longitude_bias_deg=2e-6, altitude_bias_m=3.0)
    imu = only(
        type="sensor.other.imu", role_name="i", noise_accel_stddev_y=0.2, noise_gyro_bias_x=0.1, noise_gyro_bias_y=0.2
    )
    assert isinstance(imu, ImuModel)
    assert imu.accelerometer_sd_mps2 == (0, 0.2, 0)
    assert imu.gyroscope_bias_radps == (-0.1, 0.2, 0)  # CARLA's y lies to the right: turns about x change their sign


@pytest.mark.parametrize("preset", sorted(LIDAR_PRESETS))
def test_a_preset_takes_the_place_of_a_lidars_attributes(preset: str) -> None:
    model = only(**LIDAR, headsup_preset=preset, transform=[{"z": 1.2}])
    assert isinstance(model, LidarModel)
    assert model.height_m == 1.2
    assert model.elevations_rad.tolist() == LIDAR_PRESETS[preset]().elevations_rad.tolist()


@pytest.mark.parametrize("name", sorted(RIGS))
def test_built_in_rigs_can_be_written_and_read_again(name: str) -> None:
    rig = sensor_rig(name)
    again = read_sensors(json.loads(json.dumps({"sensors": rig.entries})))
    assert [sensor.name for sensor in again.sensors] == [sensor.name for sensor in rig.sensors]
    for one, other in zip(rig.sensors, again.sensors, strict=True):
        assert np.array_equal(one.vehicle_from_sensor, other.vehicle_from_sensor)
        assert one.tick_s == other.tick_s
    assert any(isinstance(sensor.model, GnssModel | CarlaGnss) for sensor in rig.sensors)


@pytest.mark.parametrize(
    ("entry", "complaint"),
    [
        ({**LIDAR, "chanels": 64}, r"sensor 1 \(sensor.lidar.ray_cast, lidar\): chanels: there is no such field"),
        ({**LIDAR, "channels": 0}, "channels: .*greater than 0"),
        ({**LIDAR, "range": "far"}, "range: .*number"),
        ({**LIDAR, "range": math.nan}, "range"),
        ({**LIDAR, "dropoff_general_rate": 1.5}, "dropoff_general_rate"),
        ({**LIDAR, "horizontal_fov": 120}, "horizontal_fov"),
        ({**LIDAR, "transform": [{}, {}]}, "transform"),
        ({**LIDAR, "transform": [{"zz": 1}]}, "zz: there is no such field"),
        ({**LIDAR, "headsup_preset": "vlp999"}, "headsup_preset: .*hdl64"),
        ({**LIDAR, "points_per_second": 10}, "enough points"),
        ({"type": "sensor.lidar.ray_cast"}, "role_name"),
        ({"type": "sensor.radar", "role_name": "r"}, "type: must be one of sensor.camera.rgb"),
        ({"role_name": "r"}, "type: must be one of"),
        ("lidar", "not an object"),
    ],
)
def test_what_is_wrong_is_named_with_its_sensor_and_field(entry: object, complaint: str) -> None:
    with pytest.raises(SensorConfigError, match=complaint):
        read_sensors({"sensors": [entry]})


def test_two_sensors_of_one_type_need_two_names() -> None:
    with pytest.raises(SensorConfigError, match="role_name"):
        read_sensors({"sensors": [LIDAR, LIDAR]})


def test_carlas_lens_and_exposure_are_accepted() -> None:
    assert isinstance(
        only(type="sensor.camera.rgb", role_name="c", fstop="1.4", exposure_mode="histogram"), CameraModel
    )


@pytest.mark.parametrize("content", ["[]", '{"sensors": {}}', '{"sensors": [], "more": 1}', "{", "\x00"])
def test_a_file_of_another_form_is_a_clear_error(tmp_path: Path, content: str) -> None:
    path = tmp_path / "sensors.json"
    path.write_text(content)
    with pytest.raises(SensorConfigError, match=r"sensors\.json: (must be|is not JSON)"):
        load_sensors(path)


def test_an_absent_file_and_an_unknown_rig_are_clear_errors(tmp_path: Path) -> None:
    with pytest.raises(SensorConfigError, match="cannot be read"):
        load_sensors(tmp_path / "none.json")
    with pytest.raises(SensorConfigError, match="paper, hdl64, hdl32"):
        sensor_rig("vlp999")


@pytest.mark.parametrize(
    ("sensors", "said"),
    [
        ([], "there is no sensor"),
        ([{"type": "sensor.camera.rgb", "role_name": "a", "image_size_x": 1_000_000}], "image_size_x"),
        ([{"type": "sensor.lidar.ray_cast", "role_name": "a", "channels": 100_000}], "channels"),
        ([{"type": "sensor.lidar.ray_cast", "role_name": "a", "transform": [{"z": 1e308}]}], "transform"),
        ([{"type": "sensor.lidar.ray_cast", "role_name": "../../a"}], "role_name"),
        (
            [
                {"type": "sensor.lidar.ray_cast", "role_name": "a", "rotation_frequency": 10},
                {"type": "sensor.lidar.ray_cast", "role_name": "b", "rotation_frequency": 20},
            ],
            "the same rotation_frequency",
        ),
    ],
)
def test_a_rig_that_would_record_nothing_or_too_much_is_refused(sensors: list[dict[str, object]], said: str) -> None:
    with pytest.raises(SensorConfigError, match=said):
        read_sensors({"sensors": sensors})
