"""The sensors of a vehicle, in the form of the authors' `sensors.json`: CARLA's blueprints with their attributes.

{"sensors": [{"type": "sensor.lidar.ray_cast", "role_name": "lidar", "transform": [{"z": 2.4}], "channels": 64}, ...]}
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from simulator.readings import SensorName
from simulator.sensors.camera import CameraModel
from simulator.sensors.gnss import GnssError
from simulator.sensors.imu import ImuModel
from simulator.sensors.lidar import LidarModel
from simulator.sensors.sensor_blueprints import Blueprint

FloatArray = NDArray[np.float64]
Model = LidarModel | CameraModel | GnssError | ImuModel

TYPES = (
    "sensor.camera.rgb",
    "sensor.camera.semantic_segmentation",
    "sensor.lidar.ray_cast",
    "sensor.lidar.ray_cast_semantic",
    "sensor.other.gnss",
    "sensor.other.imu",
)


class SensorConfigError(ValueError):
    """A sensor set-up cannot be used; the message names the sensor and the field."""


_BLUEPRINT: TypeAdapter[Blueprint] = TypeAdapter(Blueprint)


@dataclass(frozen=True, slots=True)
class RigSensor:
    """One sensor on a vehicle: `vehicle_from_sensor` (4, 4) of its mounting frame (x forward, y left, z up).

    `tick_s` is the time between two measurements, 0 for one at every frame of the world. `entry` is its place in
    `sensors.json`, as it was given.
    """

    name: SensorName
    model: Model
    vehicle_from_sensor: FloatArray
    tick_s: float
    entry: Mapping[str, object]


@dataclass(frozen=True, slots=True)
class SensorRig:
    """The sensors of a vehicle, in the order of the configuration."""

    sensors: tuple[RigSensor, ...]

    @property
    def entries(self) -> list[dict[str, object]]:
        """The list of `sensors.json`."""
        return [dict(sensor.entry) for sensor in self.sensors]


def load_sensors(path: Path) -> SensorRig:
    """The rig that a `sensors.json` describes; `SensorConfigError` says what is wrong with it."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SensorConfigError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise SensorConfigError(f"{path}: is not JSON: {error}") from error
    try:
        return read_sensors(content)
    except SensorConfigError as error:
        raise SensorConfigError(f"{path}: {error}") from error


def read_sensors(content: object) -> SensorRig:
    """The rig of a `sensors.json` that has been parsed; `SensorConfigError` names the sensor and the field."""
    if not isinstance(content, dict) or set(content) != {"sensors"} or not isinstance(content["sensors"], list):
        raise SensorConfigError('must be {"sensors": [...]} and nothing else')
    sensors = tuple(_sensor(index, entry) for index, entry in enumerate(content["sensors"], start=1))
    if not sensors:
        raise SensorConfigError("there is no sensor in it")
    rates = {sensor.model.rate_hz for sensor in sensors if isinstance(sensor.model, LidarModel)}
    if len(rates) > 1:
        raise SensorConfigError(
            f"its LiDARs turn {' and '.join(f'{rate:g}' for rate in sorted(rates))} times a second; "
            "a frame is one turn, so give all the same rotation_frequency"
        )
    counted = Counter(sensor.name for sensor in sensors)
    for name, times in counted.items():
        if times > 1:
            raise SensorConfigError(f"{times} sensors are {name.type} {name.role!r}; give each its own role_name")
    return SensorRig(sensors)


def _sensor(index: int, entry: object) -> RigSensor:
    if not isinstance(entry, dict):
        raise SensorConfigError(f"sensor {index}: is not an object with a type")
    label = f"sensor {index} ({entry.get('type', 'without a type')}, {entry.get('role_name', 'without a role_name')})"
    try:
        parsed = _BLUEPRINT.validate_python(entry)
        model = parsed.model()
    except ValidationError as error:
        raise SensorConfigError(f"{label}: {_first(error)}") from error
    except ValueError as error:
        raise SensorConfigError(f"{label}: {error}") from error
    name = SensorName(parsed.type, parsed.role_name)
    return RigSensor(name, model, parsed.transform[0].vehicle_from_sensor, parsed.tick_s, entry)


def _first(error: ValidationError) -> str:
    problem = error.errors()[0]
    field = ".".join(str(part) for part in problem["loc"][1:]) or "type"
    if problem["type"].startswith("union_tag"):
        return f"type: must be one of {', '.join(TYPES)}"
    if problem["type"] == "extra_forbidden":
        return f"{field}: there is no such field"
    return f"{field}: {problem['msg']}"
