"""The tables and the description that a recording may carry beside its sweeps: fixes, inertia, odometry, clock, place.

They are our own extension of the layout of CARLA recordings (`docs/recordings.md`).
"""

from __future__ import annotations

import bisect
import csv
import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from scipy.spatial.transform import Rotation

from contract.geometry import LatLon
from vehicle_client.frames import GeoOrigin, Matrix, rigid
from vehicle_client.sources.carla_text import right_handed
from vehicle_client.sources.checked_values import LEAST_SD_M
from vehicle_client.sources.frame import SourceError

Row = TypeVar("Row")

STAMP_RESOLUTION_S = 1e-6
"""CARLA's texts of a time have six decimals: a reading of the sweep's moment may seem to come after it."""


class _Clock(BaseModel):
    start_unix_s: float = Field(allow_inf_nan=False)


class _Place(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False)
    latitude_deg: float = Field(ge=-90, le=90)
    longitude_deg: float = Field(ge=-180, le=180)
    altitude_m: float


class _Mounting(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False)
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0
    roll: float = 0.0


class _Sensor(BaseModel):
    type: str
    role_name: str = ""
    transform: list[_Mounting] = Field(default_factory=list)


class _Description(BaseModel):
    clock: _Clock
    georeference: _Place
    enu_from_street: list[list[float]]
    sensors: list[_Sensor]


@dataclass(frozen=True, slots=True)
class Description:
    """What `recording.json` says: Unix time of the world's time 0, where the world lies, where the sensors sit."""

    start_s: float
    origin: GeoOrigin | None
    enu_from_world: Matrix
    mountings: dict[tuple[str, str], Matrix]
    """`vehicle_from_sensor` by type and role."""

    def mounting(self, folder: str) -> Matrix | None:
        """`vehicle_from_sensor` of the sensor of a folder, which is named by its type or by type.role."""
        return next((m for (kind, role), m in self.mountings.items() if folder in (kind, f"{kind}.{role}")), None)

    def first(self, kind: str) -> Matrix:
        """`vehicle_from_sensor` of the first sensor of a type; the vehicle's own origin where there is none."""
        return next((m for (of, _), m in self.mountings.items() if of == kind), np.eye(4))


PLAIN = Description(0.0, None, np.eye(4), {})
"""A recording of the authors' own, which has no recording.json."""


def read_description(folder: Path) -> Description:
    """The description of a run; `SourceError` if it is there and cannot be understood."""
    path = folder / "recording.json"
    if not path.exists():
        return PLAIN
    try:
        text = path.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise SourceError(f"{path}: expected the description of a recording: {error}") from error
    return parse_description(text, path)


def parse_description(text: str, place: Path) -> Description:
    """What recording.json says; `SourceError`, which names the place, if it cannot be understood."""
    try:
        said = _Description.model_validate(json.loads(text))
    except (ValueError, ValidationError) as error:
        reason = str(error).splitlines()[0]
        raise SourceError(f"{place}: expected the description of a recording: {reason}") from error
    enu_from_world = np.array(said.enu_from_street, dtype=np.float64)
    if enu_from_world.shape != (4, 4) or not np.isfinite(enu_from_world).all():
        raise SourceError(f"{place}: expected enu_from_street as 4 x 4 numbers")
    at = said.georeference
    position = LatLon(latitude_deg=at.latitude_deg, longitude_deg=at.longitude_deg)
    mountings = {
        (s.type, s.role_name): right_handed(np.array([m.x, m.y, m.z]), m.pitch, m.yaw, m.roll)
        for s in said.sensors
        for m in (s.transform or [_Mounting()])[:1]
    }
    return Description(said.clock.start_unix_s, GeoOrigin(position, at.altitude_m), enu_from_world, mountings)


@dataclass(frozen=True, slots=True)
class RecordedFix:
    """A line of gnss.csv: the antenna's place, and the world's time."""

    time_s: float
    position: LatLon
    altitude_m: float
    sd_m: float
    altitude_sd_m: float


@dataclass(frozen=True, slots=True)
class RecordedOdometry:
    """A line of odometry.csv."""

    odom_from_vehicle: Matrix
    speed_mps: float


@dataclass(frozen=True, slots=True)
class Timeline(Generic[Row]):
    """Rows with their times (or frames), in order; the one before a moment is found quickly."""

    rows: Sequence[tuple[float, Row]]

    def latest(self, after: float, until: float) -> Row | None:
        """The last row in (after, until]."""
        index = bisect.bisect_right(self.rows, until + STAMP_RESOLUTION_S, key=_time) - 1
        return self.rows[index][1] if index >= 0 and _time(self.rows[index]) > after + STAMP_RESOLUTION_S else None

    def between(self, after: float, until: float) -> Sequence[tuple[float, Row]]:
        """The rows in (after, until], with their times."""
        first, end = (bisect.bisect_right(self.rows, t + STAMP_RESOLUTION_S, key=_time) for t in (after, until))
        return self.rows[first:end]


def fix_of(row: dict[str, str]) -> tuple[float, RecordedFix]:
    """A row of gnss.csv, and its time."""
    position = LatLon(latitude_deg=_finite(row["latitude_deg"]), longitude_deg=_finite(row["longitude_deg"]))
    altitude_m, sd_m, altitude_sd_m = (_finite(row[name]) for name in ("altitude_m", "sd_m", "altitude_sd_m"))
    time_s = _finite(row["time_s"])
    sds = (max(sd_m, LEAST_SD_M), max(altitude_sd_m, LEAST_SD_M))
    return time_s, RecordedFix(time_s, position, altitude_m, *sds)


def compass_of(row: dict[str, str]) -> tuple[float, float]:
    """The heading in a row of imu.csv, radians clockwise from north, and its time."""
    return _finite(row["time_s"]), _finite(row["compass_rad"])


def yaw_rate_of(row: dict[str, str]) -> tuple[float, float]:
    """The yaw rate in a row of imu.csv, rad/s to the left, and its time."""
    return _finite(row["time_s"]), _finite(row["gyroscope_z_radps"])


def odometry_of(row: dict[str, str]) -> tuple[int, RecordedOdometry]:
    """A row of odometry.csv, and its frame."""
    turn = Rotation.from_quat([_finite(row[name]) for name in ("qx", "qy", "qz", "qw")]).as_matrix()
    pose = rigid(turn, np.array([_finite(row[name]) for name in ("x_m", "y_m", "z_m")]))
    return int(row["frame"]), RecordedOdometry(pose, _finite(row["speed_mps"]))


def number_of(row: dict[str, str]) -> int:
    """The frame of a row."""
    return int(row["frame"])


def read_table(path: Path, row_of: Callable[[dict[str, str]], Row]) -> tuple[list[Row], int]:
    """The rows of a table that can be understood, and how many could not; none where there is no such file."""
    if not path.is_file():
        return [], 0
    rows: list[Row] = []
    bad = 0
    with path.open(encoding="utf-8", errors="replace", newline="") as file:
        for line in _rows_of(csv.DictReader(file)):
            try:
                rows.append(row_of(line))
            except (ValueError, KeyError, TypeError):  # a missing column, a cut line, words for numbers
                bad += 1
    return rows, bad


def _rows_of(reader: csv.DictReader[str]) -> Iterator[dict[str, str]]:
    """Rows, an empty one for each that is no CSV."""
    while True:
        try:
            yield next(reader)
        except StopIteration:
            return
        except csv.Error:
            yield {}


def _time(row: tuple[float, object]) -> float:
    return row[0]


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text} is not finite")
    return value
