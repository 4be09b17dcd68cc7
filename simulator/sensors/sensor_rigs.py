"""Sets of sensors that need no file: the paper's, and cars with LiDARs that exist."""

from __future__ import annotations

import json
from collections.abc import Callable

from simulator.sensors.sensor_config import SensorConfigError, SensorRig, read_sensors

PAPER_HEIGHT_M = 2.4
Entry = dict[str, object]


def _at(x: float, z: float, pitch: float = 0.0) -> list[Entry]:
    return [{"x": x, "y": 0.0, "z": z, "roll": 0.0, "pitch": pitch, "yaw": 0.0}]


def _paper() -> list[Entry]:
    """The paper's section "Experimental Setup". It states no noise: ranges have 10 mm here, GNSS and IMU have none."""
    return [
        {
            "type": "sensor.camera.rgb",
            "role_name": "rgb",
            "transform": _at(0.0, PAPER_HEIGHT_M),
            "image_size_x": 1024,
            "image_size_y": 512,
            "fov": 100.0,
        },
        {
            "type": "sensor.lidar.ray_cast",
            "role_name": "lidar",
            "transform": _at(0.0, PAPER_HEIGHT_M),
            "channels": 64,
            "range": 100.0,
            "points_per_second": 800_000,
            "rotation_frequency": 30.0,
            "upper_fov": 10.0,
            "lower_fov": -30.0,
            "dropoff_general_rate": 0.0,
            "dropoff_zero_intensity": 0.0,
            "noise_stddev": 0.01,
        },
        {"type": "sensor.other.gnss", "role_name": "gnss", "transform": _at(0.0, PAPER_HEIGHT_M)},
        {"type": "sensor.other.imu", "role_name": "imu", "transform": _at(0.0, PAPER_HEIGHT_M)},
    ]


def _with_real(preset: str, height_m: float) -> list[Entry]:
    """A car as data sets drive them: a LiDAR on the roof, a camera behind the windshield, a receiver, a MEMS unit."""
    return [
        {
            "type": "sensor.camera.rgb",
            "role_name": "front",
            "transform": _at(0.6, 1.6, -4.0),
            "image_size_x": 1280,
            "image_size_y": 720,
            "fov": 65.0,
            "sensor_tick": 0.1,
        },
        {
            "type": "sensor.lidar.ray_cast",
            "role_name": "lidar",
            "transform": _at(0.0, height_m),
            "headsup_preset": preset,
        },
        {
            "type": "sensor.other.gnss",
            "role_name": "gnss",
            "transform": _at(0.0, 1.5),
            "sensor_tick": 0.1,
            "headsup_preset": "receiver",
        },
        {
            # Noise of a consumer inertial unit: 150 ug and 0.01 deg/s a root hertz, at 100 Hz.
            "type": "sensor.other.imu",
            "role_name": "imu",
            "transform": _at(0.0, 0.5),
            "sensor_tick": 0.01,
            "noise_accel_stddev_x": 0.015,
            "noise_accel_stddev_y": 0.015,
            "noise_accel_stddev_z": 0.015,
            "noise_gyro_stddev_x": 0.0017,
            "noise_gyro_stddev_y": 0.0017,
            "noise_gyro_stddev_z": 0.0017,
            "headsup_compass_stddev": 0.3,
        },
    ]


RIGS: dict[str, Callable[[], list[Entry]]] = {
    "paper": _paper,
    "hdl64": lambda: _with_real("hdl64", 1.73),
    "hdl32": lambda: _with_real("hdl32", 1.84),
}
"""The names that commands use."""


def sensor_rig(name: str) -> SensorRig:
    """A rig of `RIGS`; `SensorConfigError` for another name."""
    if name not in RIGS:
        raise SensorConfigError(f"there is no set of sensors called {name!r}; there are {', '.join(RIGS)}")
    return read_sensors({"sensors": RIGS[name]()})


def paper_sensors_json() -> str:
    """The paper's `sensors.json`, to begin one's own with."""
    return json.dumps({"sensors": _paper()}, indent=2) + "\n"
