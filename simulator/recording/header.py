"""What is true of a whole recording: where and when it was made, and with which sensors."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from simulator.readings import SensorName
from simulator.recording.files import RecordingError
from simulator.streets.street import GeoReference

FloatArray = NDArray[np.float64]

LAYOUT = "headsup-carla-layout"
LAYOUT_VERSION = 1

CONVENTIONS = {
    "sweeps": "PLY in the sensor's frame when each point was fired, left-handed as in CARLA: x forward, y right, z up; "
    "metres",
    "metadata": "CARLA's world: the frame street with y turned round (left-handed); metres, degrees",
    "steering": "steering_norm: 1 is 70 degrees to the right, as in CARLA; steering_true: degrees; poses.csv: radians, "
    "positive to the left",
    "street": "right-handed, z up, metres; enu_from_street takes it to east, north, up about the georeference",
    "poses.csv": "exact pose of the vehicle frame (x forward, y left, z up, on the road) in street; unit quaternion",
    "odometry.csv": "what wheels and gyro say: pose of the vehicle in a frame of the drive's own, smooth and drifting",
    "gnss.csv": "WGS 84 degrees, metres above the ellipsoid, of the antenna, with the sensor's errors",
    "imu.csv": "specific force and angular rate about the sensor's axes, x forward, y left, z up; compass clockwise "
    "from north",
    "labels": "a row for each point of the sweep of the same number, in the same order; time_offset_s from the sweep's "
    "stamp, its end",
    "semantic": "tags of CARLA 0.9.16; ObjIdx of an obstacle is its number plus 1000000",
    "time": "time_s counts from clock.start",
}


@dataclass(frozen=True, slots=True)
class RecordingHeader:
    """How a recording was made.

    `start` (with an offset) is the moment of the world's time 0, `tick_s` the step between frames; `sensors` is the
    list of `sensors.json`, each a mapping with at least `type` and `role_name`; `enu_from_street` (4, 4). `asked` are
    the options it was made with, in plain values, where it can be made again.
    """

    made_by: str
    seed: int
    start: datetime
    tick_s: float
    georeference: GeoReference
    enu_from_street: FloatArray
    sensors: Sequence[Mapping[str, object]]
    asked: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.start.utcoffset() is None:
            raise RecordingError("the start of a recording needs its offset from UTC")

    @property
    def start_ns(self) -> int:
        """Unix time of the world's time 0, nanoseconds."""
        return round(self.start.timestamp() * 1e6) * 1000

    def as_json(self) -> dict[str, object]:
        """The part of recording.json that is known before the first frame."""
        place = self.georeference.position
        return {
            "layout": LAYOUT,
            "version": LAYOUT_VERSION,
            "made_by": self.made_by,
            "seed": self.seed,
            "asked": dict(self.asked),
            "clock": {"start": self.start.isoformat(), "start_unix_s": self.start.timestamp(), "tick_s": self.tick_s},
            "georeference": {
                "latitude_deg": place.latitude_deg,
                "longitude_deg": place.longitude_deg,
                "altitude_m": self.georeference.altitude_m,
            },
            "enu_from_street": self.enu_from_street.tolist(),
            "sensors": [dict(sensor) for sensor in self.sensors],
            "conventions": CONVENTIONS,
        }


def sensor_folders(sensors: Sequence[Mapping[str, object]]) -> dict[SensorName, str]:
    """Name of each sensor's folder: CARLA's type, and where a type occurs twice the role after it.

    `RecordingError` for sensors that could not be told apart, and for names that make no file name.
    """
    names = [SensorName(str(sensor.get("type", "")), str(sensor.get("role_name", ""))) for sensor in sensors]
    times = Counter(name.type for name in names)
    folders = {name: name.type if times[name.type] == 1 else f"{name.type}.{name.role}" for name in names}
    if len(set(folders.values())) < len(names):
        raise RecordingError("two sensors of the same type need different role_names")
    for folder in folders.values():
        if not re.fullmatch(r"[A-Za-z0-9_]+([.-][A-Za-z0-9_]+)*", folder):
            raise RecordingError(f"{folder!r} cannot name a folder; use letters, digits, - and _ in type and role_name")
    return folders
