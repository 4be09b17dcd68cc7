from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import carla
import cv2
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from headsup.simulate.record_carla_command import record_carla
from simulator.carla_bridge import session
from simulator.carla_bridge.measurements import lidar_sweep, map_origin, reading_of, semantic_sweep
from simulator.carla_bridge.problem import CarlaBridgeError
from simulator.carla_bridge.record import RecordingPlan, record
from simulator.carla_bridge.session import connect
from simulator.recording.files import RecordingError
from simulator.sensors.sensor_config import SensorRig, read_sensors
from tests.unit.simulator import carla_server as stand_in
from tests.unit.simulator.carla_server import Client, Sensor, Vehicle, World
from vehicle_client.sources.carla_recording import CarlaRecording

LIDAR = {
    "type": "sensor.lidar.ray_cast",
    "role_name": "lidar",
    "transform": [{"x": 0.2, "y": 0.1, "z": 2.4}],
    "channels": 4,
    "rotation_frequency": 20.0,
}
SENSORS = [
    LIDAR,
    {"type": "sensor.lidar.ray_cast_semantic", "role_name": "lidar", "rotation_frequency": 20.0},
    {"type": "sensor.camera.rgb", "role_name": "rgb", "sensor_tick": 0.1, "fov": 100},
    {"type": "sensor.camera.semantic_segmentation", "role_name": "tags"},
    {"type": "sensor.other.gnss", "role_name": "gnss", "noise_lat_stddev": 1e-5},
    {"type": "sensor.other.imu", "role_name": "imu"},
]
TICKS = 4


def rig(*entries: dict[str, object]) -> SensorRig:
    return read_sensors({"sensors": list(entries or SENSORS)})


def plan(**changes: object) -> RecordingPlan:
    return replace(RecordingPlan(egos=2, seconds=0.05 * TICKS, seed=3, rig=rig(), mcap=False, within_s=5.0), **changes)


def assert_left_as_found(client: Client) -> None:
    world = client.world
    assert not world.settings.synchronous_mode
    assert not world.settings.fixed_delta_seconds
    assert not client.manager.synchronous
    assert not [actor.id for actor in world.actors if actor.is_alive]
    assert sorted(world.destroyed) == sorted(actor.id for actor in world.actors)
    assert all(actor.callback is None for actor in world.actors if isinstance(actor, Sensor))


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Client:
    client = Client()
    client.folder = tmp_path_factory.mktemp("carla") / "run"
    assert record(client, plan(), client.folder) == TICKS
    return client


def test_the_server_is_left_as_it_was_found(client: Client) -> None:
    assert_left_as_found(client)
    assert client.manager.seed == 3


def test_sensors_go_before_the_vehicles_that_carry_them(client: Client) -> None:
    alive_order = [
        isinstance(a, Vehicle) for number in client.world.destroyed for a in client.world.actors if a.id == number
    ]
    assert alive_order == sorted(alive_order)


def test_attributes_of_the_configuration_reach_the_blueprints(client: Client) -> None:
    sensors = [actor for actor in client.world.actors if isinstance(actor, Sensor)]
    assert len(sensors) == 2 * len(SENSORS)
    assert sensors[0].blueprint.values == {"role_name": "lidar", "channels": "4", "rotation_frequency": "20.0"}
    assert sensors[2].blueprint.values == {"role_name": "rgb", "fov": "100"}
    place = sensors[0].transform.location
    assert (place.x, place.y, place.z) == pytest.approx((0.2, 0.1, 2.4))


def test_the_recording_has_a_frame_a_tick_and_slower_sensors_less_often(client: Client) -> None:
    ego = client.folder / "ego1"
    settled = 500 + 20  # a second of ticks before the sensors are attached
    numbers = [int(path.stem) for path in sorted((ego / "sensor.lidar.ray_cast").glob("*.ply"))]
    assert numbers == [settled + 1 + i for i in range(TICKS)]
    assert [int(p.stem) for p in sorted((ego / "sensor.camera.rgb").glob("*.png"))] == [numbers[0], numbers[2]]
    said = json.loads((client.folder / "recording.json").read_text())
    assert said["made_by"] == "CARLA 0.9.16, Carla/Maps/Town"
    assert said["clock"]["tick_s"] == pytest.approx(0.05)
    assert said["georeference"]["latitude_deg"] == pytest.approx(38.2)
    assert said["sensors"] == SENSORS


def test_each_file_holds_the_measurement_of_its_own_frame(client: Client) -> None:
    for path in (client.folder / "ego0/sensor.lidar.ray_cast").glob("*.ply"):
        rows = np.loadtxt(path, skiprows=8)
        assert rows == pytest.approx(stand_in.lidar_rows(int(path.stem)), abs=6e-5)
    for path in (client.folder / "ego0/sensor.camera.rgb").glob("*.png"):
        assert cv2.imread(path, cv2.IMREAD_UNCHANGED).tolist() == stand_in.picture(int(path.stem))[..., :3].tolist()
    for path in (client.folder / "ego0/sensor.camera.semantic_segmentation").glob("*.png"):
        assert cv2.imread(path)[..., 2].tolist() == stand_in.picture(int(path.stem))[..., 2].tolist()


def test_tags_and_objects_of_carla_stay_what_they_are(client: Client) -> None:
    path = next((client.folder / "ego0/sensor.lidar.ray_cast_semantic").glob("*.ply"))
    rows = np.loadtxt(path, skiprows=10)
    assert (rows[:, 3:] == [0.75, 42, 15]).all()


def test_metadata_is_the_text_of_carlas_own_transform(client: Client) -> None:
    line = (client.folder / "ego0/sensor.lidar.ray_cast/lidar_metadata.txt").read_text().splitlines()[0]
    vehicle = next(actor for actor in client.world.actors if isinstance(actor, Vehicle))
    at = vehicle.transform.location
    # A second of settling and one tick, at 10 m/s from the 3 s at which the world was found.
    expected = carla.Transform(carla.Location(at.x + 10 * 4.05 + 0.2, at.y + 0.1, at.z + 2.4), carla.Rotation())
    assert line.startswith(
        "LidarMeasurement(frame=521, timestamp=4.050000, number_of_points=100), Transform(Location(x="
    )
    numbers = [float(part.strip("()")) for part in line.split("Location(")[1].replace(",", "=").split("=")[1:6:2]]
    assert numbers == pytest.approx([expected.location.x, expected.location.y, expected.location.z], abs=1e-4)


def test_steering_is_carlas_and_speed_the_vehicles(client: Client) -> None:
    values = (client.folder / "ego0/steering_norm.txt").read_text().split(", ")
    assert [float(v) for v in values] == pytest.approx([0.25] * TICKS)
    poses = np.genfromtxt(client.folder / "ego0/poses.csv", delimiter=",", names=True)
    assert poses["speed_mps"].tolist() == [10.0] * TICKS
    assert poses["steering_rad"] == pytest.approx([-math.radians(17.5)] * TICKS)
    odometry = np.genfromtxt(client.folder / "ego0/odometry.csv", delimiter=",", names=True)
    assert odometry["x_m"] == pytest.approx([0.0, 0.5, 1.0, 1.5], abs=1e-4)


def test_fixes_lie_where_the_vehicle_is_and_not_mirrored(client: Client) -> None:
    fixes = np.genfromtxt(client.folder / "ego0/gnss.csv", delimiter=",", names=True)
    poses = np.genfromtxt(client.folder / "ego0/poses.csv", delimiter=",", names=True)
    # Degrees of latitude: 1e-7 is a centimetre; CARLA's y = 2 .. 14 m would be mirrored by up to 28 m.
    assert fixes["latitude_deg"] == pytest.approx(poses["latitude_deg"], abs=1e-6)
    assert fixes["longitude_deg"] == pytest.approx(poses["longitude_deg"], abs=1e-6)
    assert (fixes["latitude_deg"] <= 38.2).all()
    assert fixes["sd_m"] == pytest.approx([1.11] * TICKS, abs=0.01)


def test_inertia_is_turned_to_our_axes(client: Client) -> None:
    row = np.genfromtxt(client.folder / "ego0/imu.csv", delimiter=",", names=True)[0]
    assert [row[f"accelerometer_{a}_mps2"] for a in "xyz"] == pytest.approx([1.0, -2.0, 9.8])
    assert [row[f"gyroscope_{a}_radps"] for a in "xyz"] == pytest.approx([-0.1, 0.2, -0.3])
    assert row["compass_rad"] == 1.5


def test_the_vehicle_reads_what_was_recorded(client: Client) -> None:
    source = CarlaRecording(client.folder, ego=1)
    frames = list(source)
    assert (len(frames), source.skipped) == (TICKS, 0)
    made = stand_in.lidar_rows(522)
    assert frames[1].points_m == pytest.approx(made[:, :3] * [1, -1, 1], abs=6e-5)
    assert [frame.image is None for frame in frames] == [False, True, False, True]
    poses = np.genfromtxt(client.folder / "ego1/poses.csv", delimiter=",", names=True)
    for frame, pose in zip(frames, poses, strict=True):
        assert frame.stamp_s == pytest.approx(plan().start.timestamp() + pose["time_s"], abs=1e-5)
        assert frame.steering_rad == pytest.approx(pose["steering_rad"])
        assert frame.gnss.position.latitude_deg == pytest.approx(pose["latitude_deg"], abs=1e-7)


def measurement(rows: np.ndarray) -> stand_in.Lidar:
    return stand_in.Lidar(1, 0.05, carla.Transform(), rows.tobytes())


def test_a_sweep_is_right_handed_and_its_ring_zero_looks_down_most() -> None:
    rows = stand_in.lidar_rows(1)
    sweep = lidar_sweep(measurement(rows))
    assert sweep.points_m.tolist() == (rows[:, :3] * [1, -1, 1]).astype(np.float32).tolist()
    assert sweep.ring[:: stand_in.POINTS_A_CHANNEL].tolist() == [3, 2, 1, 0]
    assert sweep.azimuth_rad == pytest.approx(np.arctan2(-rows[:, 1], rows[:, 0]))
    assert semantic_sweep(measurement(stand_in.semantic_rows(1))).mover_id.tolist() == [42] * 100


def test_a_turn_that_hit_nothing_is_an_empty_sweep() -> None:
    empty = measurement(np.zeros((0, 4), "<f4"))
    empty.get_point_count = lambda channel: 0  # type: ignore[method-assign]
    assert len(lidar_sweep(empty).points_m) == 0


def test_a_reading_keeps_the_sensors_name_and_pose() -> None:
    sensor = rig(LIDAR).sensors[0]
    data = measurement(stand_in.lidar_rows(1))
    data.transform = carla.Transform(carla.Location(1, 2, 3), carla.Rotation(yaw=90))
    reading = reading_of(sensor, data, None, None)
    assert reading.sensor == sensor.name
    assert reading.street_from_sensor[:3, 3] == pytest.approx([1, -2, 3])
    assert reading.street_from_sensor[:3, 0] == pytest.approx([0, -1, 0], abs=1e-6)  # yaw to the right


def test_carlas_default_place_is_warned_of(caplog: pytest.LogCaptureFixture) -> None:
    assert map_origin(carla.Map("Town", stand_in.XODR)).position.latitude_deg == pytest.approx(38.2)
    assert not caplog.messages
    map_origin(carla.Map("Town", stand_in.XODR.replace("+lat_0", "+x")))
    assert "latitude 42, longitude 2" in caplog.text


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, RuntimeError, ValueError])
def test_the_server_is_left_as_it_was_found_after_an_interruption(
    tmp_path: Path, interruption: type[BaseException]
) -> None:
    client, done = Client(), []

    def on_tick() -> None:
        done.append(1)
        if len(done) == 2:
            raise interruption("stop")

    with pytest.raises(interruption):
        record(client, plan(), tmp_path / "run", on_tick)
    assert_left_as_found(client)
    assert not (tmp_path / "run/recording.json").exists()


def test_a_sensor_that_falls_silent_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Sensor, "silent_at", 523)
    client = Client()
    with pytest.raises(
        CarlaBridgeError, match=r"sensor.lidar.ray_cast 'lidar' sent nothing for frame 523 within 0.2 s"
    ):
        record(client, plan(within_s=0.2), tmp_path / "run")
    assert_left_as_found(client)


def test_a_sensor_that_runs_ahead_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    measured = Sensor.measured
    monkeypatch.setattr(Sensor, "measured", lambda self, frame, time_s: measured(self, frame + 2, time_s))
    with pytest.raises(CarlaBridgeError, match="skipped frame 521"):
        record(Client(), plan(), tmp_path / "run")


def test_vehicles_take_the_free_spawn_points_that_the_seed_chooses(tmp_path: Path) -> None:
    places = []
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        client = Client(World(taken=frozenset({0, 1, 2})))
        record(client, plan(seed=seed, seconds=0.05), tmp_path / name)
        vehicles = [actor for actor in client.world.actors if isinstance(actor, Vehicle)]
        assert [v.blueprint.values["role_name"] for v in vehicles] == ["ego0", "ego1"]
        places.append([v.transform.location.x for v in vehicles])
    assert places[0] == places[1] != places[2]
    assert min(min(p) for p in places) >= 30


def test_more_vehicles_than_free_places_are_refused(tmp_path: Path) -> None:
    client = Client(World(taken=frozenset(range(1, 8))))
    with pytest.raises(CarlaBridgeError, match="8 spawn points, 1 of them free: not 2"):
        record(client, plan(), tmp_path / "run")
    assert_left_as_found(client)


def test_what_carla_does_not_know_is_refused_before_anything_drives(tmp_path: Path) -> None:
    client = Client()
    with pytest.raises(CarlaBridgeError, match="CARLA has no attribute headsup_preset"):
        record(client, plan(rig=rig({**LIDAR, "headsup_preset": "hdl64"})), tmp_path / "run")
    assert_left_as_found(client)


def test_a_turn_longer_than_carlas_physics_allows_is_refused(tmp_path: Path) -> None:
    client = Client()
    with pytest.raises(CarlaBridgeError, match=r"up to 0\.1"):
        record(client, plan(rig=rig({**LIDAR, "rotation_frequency": 5.0}), seconds=1.0), tmp_path / "run")
    assert not client.world.settings.synchronous_mode


def test_nothing_to_record_is_refused(tmp_path: Path) -> None:
    for bad in (plan(egos=0), plan(seconds=0.0), plan(rig=SensorRig(()))):
        with pytest.raises(CarlaBridgeError, match="at least one tick"):
            record(Client(), bad, tmp_path / "run")


def test_a_folder_in_use_is_refused_and_the_server_restored(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("x")
    client = Client()
    with pytest.raises(RecordingError, match="empty folder"):
        record(client, plan(), tmp_path)
    assert_left_as_found(client)


def test_versions_must_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session.carla, "Client", lambda host, port: Client(server_version="0.9.15"))
    with pytest.raises(CarlaBridgeError, match=r"version 0\.9\.15, the client 0\.9\.16"):
        connect("127.0.0.1", 2000)


def command(*arguments: str) -> tuple[int, str]:
    app = typer.Typer()
    app.command()(record_carla)
    result = CliRunner().invoke(app, list(arguments))
    return result.exit_code, result.output


def test_the_command_records_and_says_what_it_wrote(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    client = Client()
    monkeypatch.setattr(session.carla, "Client", lambda host, port: client)
    (tmp_path / "sensors.json").write_text(json.dumps({"sensors": SENSORS}))
    out = tmp_path / "run"
    code, text = command(
        "--out", str(out), "--sensors", str(tmp_path / "sensors.json"), "--seconds", "0.2", "--egos", "1", "--no-mcap"
    )
    assert (code, text.strip()) == (0, f"{out}: 4 frames of 1 vehicles")
    assert (out / "recording.json").is_file()
    assert_left_as_found(client)


def test_the_command_says_in_a_line_what_is_wrong(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "ANSWER_WITHIN_S", 0.3)
    code, text = command("--out", str(tmp_path / "run"), "--port", "1")
    assert code == 1
    assert "no CARLA server answers at 127.0.0.1:1; start CarlaUE4.sh there" in text
    code, text = command("--out", str(tmp_path / "run"), "--sensors", str(tmp_path / "absent.json"))
    assert code == 1
    assert "absent.json" in text
    assert not (tmp_path / "run").exists()


def test_without_the_extra_the_command_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "carla", None)
    code, text = command("--out", str(tmp_path / "run"))
    assert (code, text.strip()) == (
        1,
        "headsup simulate carla: the carla package is not installed; run pip install 'headsup[carla]'",
    )


def test_lidars_of_different_ticks_have_no_common_one(tmp_path: Path) -> None:
    slow = {**LIDAR, "role_name": "slow", "sensor_tick": 0.1}
    with pytest.raises(CarlaBridgeError, match="different rates"):
        record(Client(), plan(rig=rig(LIDAR, slow)), tmp_path / "run")
