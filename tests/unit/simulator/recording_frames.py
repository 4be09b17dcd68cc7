"""Frames as the simulator makes them, without a world: the recordings' tests share them."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from contract.geometry import Kind, LatLon
from simulator.mesh import pose
from simulator.readings import (
    EgoFrame,
    GnssReading,
    ImageReading,
    ImuReading,
    LidarReading,
    ObstacleTruth,
    Reading,
    SensorName,
    Sweep,
)
from simulator.recording.header import RecordingHeader
from simulator.recording.writer import RecordingWriter
from simulator.streets.street import GeoReference

LIDAR = SensorName("sensor.lidar.ray_cast", "roof")
SEMANTIC_LIDAR = SensorName("sensor.lidar.ray_cast_semantic", "roof")
CAMERA = SensorName("sensor.camera.rgb", "front")
SEMANTIC_CAMERA = SensorName("sensor.camera.semantic_segmentation", "front")
GNSS = SensorName("sensor.other.gnss", "antenna")
IMU = SensorName("sensor.other.imu", "imu")

MOUNTED = {
    LIDAR: pose(0.3, 0.1, 2.4, 0.02),
    SEMANTIC_LIDAR: pose(0.3, 0.1, 2.4),
    CAMERA: pose(0.6, 0.0, 1.6, 0.0, math.radians(4)),
    SEMANTIC_CAMERA: pose(0.6, 0.0, 1.6),
    GNSS: pose(-0.5, 0.4, 1.5),
    IMU: pose(0.0, 0.0, 0.5),
}
"""`vehicle_from_sensor` of each."""

ENU_FROM_STREET = pose(12.0, -7.5, 0.4, math.radians(35))
GEOREFERENCE = GeoReference(LatLon(latitude_deg=38.2466, longitude_deg=21.7346), altitude_m=60.0)
PERIOD_S = 0.1
FIRST_FRAME = 7


def sensor_json(name: SensorName) -> dict[str, object]:
    """The sensor's entry in sensors.json: CARLA's left-handed degrees."""
    from simulator.recording.handedness import carla_transform

    at = carla_transform(MOUNTED[name])
    transform = {"x": at.x, "y": at.y, "z": at.z, "roll": at.roll, "pitch": at.pitch, "yaw": at.yaw}
    return {"type": name.type, "role_name": name.role, "transform": [transform]}


def header(names: tuple[SensorName, ...] = tuple(MOUNTED)) -> RecordingHeader:
    return RecordingHeader(
        made_by="tests",
        seed=5,
        start=datetime(2026, 5, 4, 12, 0, tzinfo=UTC),
        tick_s=PERIOD_S,
        georeference=GEOREFERENCE,
        enu_from_street=ENU_FROM_STREET,
        sensors=[sensor_json(name) for name in names],
    )


def sweep(seed: int, count: int = 400) -> Sweep:
    """Points around a sensor 2.4 m above a flat road, in the order of azimuth."""
    rng = np.random.default_rng(seed)
    azimuth = np.sort(rng.uniform(-math.pi, math.pi, count))
    distance = rng.uniform(3, 40, count)
    z = np.where(rng.random(count) < 0.7, rng.normal(-2.4, 0.01, count), rng.uniform(-2.4, 1, count))
    points = np.stack([distance * np.cos(azimuth), distance * np.sin(azimuth), z], axis=1)
    return Sweep(
        points_m=points.astype(np.float32),
        ring=rng.integers(0, 64, count).astype(np.uint16),
        azimuth_rad=azimuth.astype(np.float32),
        time_offset_s=np.linspace(-PERIOD_S, 0, count).astype(np.float32),
        intensity=rng.random(count).astype(np.float32),
        cos_incidence=rng.random(count).astype(np.float32),
        surface=rng.integers(1, 15, count).astype(np.uint8),
        obstacle_id=rng.integers(0, 3, count).astype(np.int32),
        mover_id=(rng.integers(0, 5, count) // 4).astype(np.int32),
    )


def street_from_vehicle(index: int, ego: int = 0) -> np.ndarray:
    """A gentle left turn at 12 m/s over a road that rises."""
    yaw = 0.3 + 0.02 * index
    return pose(20 + 1.2 * index - 30 * ego, -1.75 + 0.1 * index, 0.05 * index, yaw, -0.04, 0.02)


def readings(index: int, street_from_body: np.ndarray, names: tuple[SensorName, ...]) -> tuple[Reading, ...]:
    rng = np.random.default_rng([index, 9])
    made: list[Reading] = []
    for name in names:
        street_from_sensor = street_from_body @ MOUNTED[name]
        if "lidar" in name.type:
            made.append(LidarReading(name, street_from_sensor, sweep(index)))
        elif name.type == "sensor.camera.rgb":
            pixels = rng.integers(0, 256, (24, 48, 3), dtype=np.uint8)
            made.append(ImageReading(name, street_from_sensor, pixels))
        elif "camera" in name.type:
            made.append(ImageReading(name, street_from_sensor, rng.integers(0, 26, (24, 48), dtype=np.uint8)))
        elif name.type == "sensor.other.gnss":
            position, altitude = GEOREFERENCE.geodetic_from_enu((ENU_FROM_STREET @ street_from_sensor)[:3, 3])
            made.append(GnssReading(name, index * PERIOD_S, position, altitude, 1.5, 3.0))
        else:
            yaw = math.atan2(*(ENU_FROM_STREET @ street_from_sensor)[[1, 0], [0, 0]])
            compass = (math.pi / 2 - yaw) % (2 * math.pi)
            made.append(ImuReading(name, index * PERIOD_S, rng.normal(0, 1, 3), rng.normal(0, 0.1, 3), compass))
    return tuple(made)


def ego_frame(index: int, ego: int = 0, names: tuple[SensorName, ...] = tuple(MOUNTED)) -> EgoFrame:
    at = street_from_vehicle(index, ego)
    return EgoFrame(
        number=FIRST_FRAME + index,
        time_s=index * PERIOD_S,
        street_from_vehicle=at,
        enu_from_vehicle=ENU_FROM_STREET @ at,
        odom_from_vehicle=np.linalg.inv(pose(20.5, -1.5, 0.0, 0.31)) @ at,
        speed_mps=12.0,
        steering_rad=0.05 - 0.01 * index,
        readings=readings(index, at, names),
    )


def obstacle(obstacle_id: int = 1, change: str = "initial", from_s: float = 0.0) -> ObstacleTruth:
    enu = (30.0, 11.0, 0.6)
    position, altitude = GEOREFERENCE.geodetic_from_enu(np.array(enu))
    return ObstacleTruth(
        obstacle_id, Kind.POTHOLE, change, from_s, position, altitude, enu, 0.4, 0.9, 0.7, 0.1, 0.49, 0.03
    )


def write_recording(
    folder: Path, frames: int = 4, egos: int = 2, names: tuple[SensorName, ...] = tuple(MOUNTED), mcap: bool = True
) -> None:
    obstacles = [obstacle(), obstacle(change="grown", from_s=0.2), obstacle(change="removed", from_s=0.3)]
    with RecordingWriter(folder, header(names), egos, obstacles, mcap=mcap) as recording:
        for index in range(frames):
            for ego in range(egos):
                recording.write(ego, ego_frame(index, ego, names))
