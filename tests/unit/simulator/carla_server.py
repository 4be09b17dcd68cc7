"""A stand-in for a CARLA server and client that behaves as CARLA 0.9.16 is documented, with carla's real plain values.

Sensors call back from another thread; a stale measurement comes before the one of the tick; a spawn point may be taken.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import Any

import carla
import numpy as np

XODR = """<?xml version="1.0"?><OpenDRIVE><header revMajor="1" revMinor="4" name="a">
<geoReference><![CDATA[+proj=tmerc +lat_0=38.2 +lon_0=21.7]]></geoReference></header>
<road name="" length="100" id="1" junction="-1"><link/><planView>
<geometry s="0" x="0" y="0" hdg="0" length="100"><line/></geometry></planView><lanes><laneSection s="0">
<left/><center><lane id="0" type="none" level="false"/></center><right><lane id="-1" type="driving" level="false">
<width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane></right></laneSection></lanes></road></OpenDRIVE>"""

ATTRIBUTES = {
    "sensor.lidar.ray_cast": {"channels", "range", "points_per_second", "rotation_frequency", "upper_fov", "lower_fov"}
    | {"dropoff_general_rate", "dropoff_zero_intensity", "noise_stddev"},
    "sensor.lidar.ray_cast_semantic": {"channels", "range", "rotation_frequency"},
    "sensor.camera.rgb": {"image_size_x", "image_size_y", "fov"},
    "sensor.camera.semantic_segmentation": {"image_size_x", "image_size_y", "fov"},
    "sensor.other.gnss": {"noise_lat_stddev", "noise_lon_stddev", "noise_alt_stddev"},
    "sensor.other.imu": {"noise_accel_stddev_x"},
    "vehicle.tesla.model3": {"color"},
}

CHANNELS, POINTS_A_CHANNEL = 4, 25


@dataclass
class Blueprint:
    id: str
    values: dict[str, str] = field(default_factory=dict)

    def has_attribute(self, name: str) -> bool:
        return name in ATTRIBUTES[self.id] | {"role_name"}

    def set_attribute(self, name: str, value: str) -> None:
        if not self.has_attribute(name):
            raise IndexError(name)
        assert isinstance(value, str)
        self.values[name] = value


class Library:
    def find(self, name: str) -> Blueprint:
        if name not in ATTRIBUTES:
            raise IndexError(name)
        return Blueprint(name)


@dataclass
class Measurement:
    """What every sensor's data has: LidarMeasurement and its kin cannot be made from Python."""

    frame: int
    timestamp: float
    transform: carla.Transform


@dataclass
class Lidar(Measurement):
    raw_data: bytes
    channels: int = CHANNELS
    horizontal_angle: float = 0.0

    def get_point_count(self, channel: int) -> int:
        assert 0 <= channel < self.channels
        return POINTS_A_CHANNEL


@dataclass
class Image(Measurement):
    raw_data: bytes
    width: int = 6
    height: int = 4
    fov: float = 90.0


@dataclass
class Gnss(Measurement):
    latitude: float
    longitude: float
    altitude: float


@dataclass
class Imu(Measurement):
    accelerometer: carla.Vector3D
    gyroscope: carla.Vector3D
    compass: float


class Actor:
    def __init__(self, world: World, number: int, blueprint: Blueprint, transform: carla.Transform) -> None:
        self.world, self.id, self.blueprint, self.transform = world, number, blueprint, transform
        self.is_alive = True

    def destroy(self) -> bool:
        self.world.destroyed.append(self.id)
        if not self.is_alive:
            raise RuntimeError("trying to operate on a destroyed actor")
        self.is_alive = False
        return True


class Vehicle(Actor):
    autopilot_port: int | None = None

    def set_autopilot(self, enabled: bool, port: int) -> None:
        self.autopilot_port = port if enabled else None

    def get_transform(self) -> carla.Transform:
        """10 m/s along x from where it was spawned, right side of the world."""
        at = self.transform.location
        moved = 10 * self.world.elapsed_s
        return carla.Transform(carla.Location(at.x + moved, at.y, at.z), self.transform.rotation)

    def get_velocity(self) -> carla.Vector3D:
        return carla.Vector3D(10.0, 0.0, 0.0)

    def get_control(self) -> carla.VehicleControl:
        return carla.VehicleControl(steer=0.25)


class Sensor(Actor):
    callback: Any = None
    parent: Vehicle
    silent_at: int | None = None

    def listen(self, callback: Any) -> None:
        self.callback = callback

    def stop(self) -> None:
        self.callback = None

    def measured(self, frame: int, time_s: float) -> Measurement:
        base = self.parent.get_transform()
        mounted = self.transform.location
        own = carla.Location(mounted.x, mounted.y, mounted.z)  # carla changes the value that it is given
        place = carla.Transform(base.transform(own), base.rotation)
        said = (frame, time_s, place)
        kind = self.blueprint.id
        if kind == "sensor.lidar.ray_cast":
            return Lidar(*said, raw_data=lidar_rows(frame).tobytes())
        if kind == "sensor.lidar.ray_cast_semantic":
            return Lidar(*said, raw_data=semantic_rows(frame).tobytes())
        if kind.startswith("sensor.camera"):
            return Image(*said, raw_data=picture(frame).tobytes())
        if kind == "sensor.other.gnss":
            fix = self.world.get_map().transform_to_geolocation(place.location)
            return Gnss(*said, fix.latitude, fix.longitude, fix.altitude)
        return Imu(*said, carla.Vector3D(1.0, 2.0, 9.8), carla.Vector3D(0.1, 0.2, 0.3), 1.5)


def lidar_rows(frame: int) -> np.ndarray:
    rows = np.random.default_rng(frame).normal(0, 10, (CHANNELS * POINTS_A_CHANNEL, 4)).astype("<f4")
    rows[:, 3] = 0.5
    return rows


def semantic_rows(frame: int) -> np.ndarray:
    kind = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("cosine", "<f4"), ("object", "<u4"), ("tag", "<u4")]
    rows = np.zeros(CHANNELS * POINTS_A_CHANNEL, dtype=kind)
    rows["x"], rows["y"], rows["z"] = lidar_rows(frame)[:, :3].T
    rows["cosine"], rows["object"], rows["tag"] = 0.75, 42, 15  # a truck
    return rows


def picture(frame: int) -> np.ndarray:
    return np.random.default_rng(frame).integers(0, 29, (4, 6, 4), dtype=np.uint8)


class World:
    def __init__(self, taken: frozenset[int] = frozenset()) -> None:
        self.settings = carla.WorldSettings(synchronous_mode=False, fixed_delta_seconds=0.0)
        self.frame, self.elapsed_s = 500, 3.0
        self.actors: list[Actor] = []
        self.destroyed: list[int] = []
        self.taken = taken
        self._map = carla.Map("Town", XODR)
        self.threads: list[threading.Thread] = []

    def get_settings(self) -> carla.WorldSettings:
        now = self.settings
        return carla.WorldSettings(
            synchronous_mode=now.synchronous_mode, fixed_delta_seconds=now.fixed_delta_seconds or 0.0
        )

    def apply_settings(self, settings: carla.WorldSettings) -> int:
        self.settings = settings
        return self.frame

    def get_map(self) -> Any:
        return self._map_with_points()

    def _map_with_points(self) -> Any:
        points = [carla.Transform(carla.Location(10.0 * i, 2.0 * i, 0.5)) for i in range(8)]

        class MapWithPoints:
            name = "Carla/Maps/Town"
            transform_to_geolocation = self._map.transform_to_geolocation
            geolocation_to_transform = self._map.geolocation_to_transform

            def get_spawn_points(self) -> list[carla.Transform]:
                return points

        return MapWithPoints()

    def get_blueprint_library(self) -> Library:
        return Library()

    def try_spawn_actor(
        self, blueprint: Blueprint, transform: carla.Transform, attach_to: Vehicle | None = None
    ) -> Actor | None:
        if attach_to is None and round(transform.location.x / 10) in self.taken:
            return None
        kind = Sensor if blueprint.id.startswith("sensor") else Vehicle
        actor = kind(self, 1000 + len(self.actors), blueprint, transform)
        if isinstance(actor, Sensor):
            assert attach_to is not None
            actor.parent = attach_to
        self.actors.append(actor)
        return actor

    def tick(self) -> int:
        assert self.settings.synchronous_mode
        self.frame += 1
        self.elapsed_s += self.settings.fixed_delta_seconds
        for actor in self.actors:
            if isinstance(actor, Sensor) and actor.callback and self.frame != actor.silent_at:
                late = actor.measured(self.frame - 1, self.elapsed_s - self.settings.fixed_delta_seconds)
                fresh = actor.measured(self.frame, self.elapsed_s)
                thread = threading.Thread(target=_deliver, args=(actor.callback, late, fresh))
                thread.start()
                self.threads.append(thread)
        return self.frame

    def get_snapshot(self) -> Any:
        stamp = carla.Timestamp(frame=self.frame, elapsed_seconds=self.elapsed_s)

        class Snapshot:
            timestamp = stamp

        return Snapshot()


def _deliver(callback: Any, late: Measurement, fresh: Measurement) -> None:
    callback(late)
    callback(fresh)


class TrafficManager:
    def __init__(self) -> None:
        self.synchronous = False
        self.seed: int | None = None

    def set_synchronous_mode(self, value: bool) -> None:
        self.synchronous = value

    def set_random_device_seed(self, seed: int) -> None:
        self.seed = seed

    def get_port(self) -> int:
        return 8000


class Client:
    def __init__(self, world: World | None = None, server_version: str = "0.9.16") -> None:
        self.world = world or World()
        self.manager = TrafficManager()
        self.server_version = server_version

    def set_timeout(self, seconds: float) -> None:
        assert seconds > 0

    def get_client_version(self) -> str:
        return "0.9.16"

    def get_server_version(self) -> str:
        return self.server_version

    def get_world(self) -> World:
        return self.world

    def get_trafficmanager(self, port: int) -> TrafficManager:
        assert port == 8000
        return self.manager
