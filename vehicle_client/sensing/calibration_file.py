"""A car's calibration as a TOML file (docs/calibration.md): where its sensors sit, and how late their readings come."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from scipy.spatial.transform import Rotation

from vehicle_client.frames import Matrix, Vector, rigid
from vehicle_client.sensing.calibration import WHEELBASE_M, CameraCalibration, VehicleCalibration
from vehicle_client.sensing.deskew import Spin
from vehicle_client.sensing.time_alignment import SensorDelays

AHEAD_FROM_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""A camera that looks straight ahead: its z is the car's x, its x the car's right, its y down."""


class CalibrationError(ValueError):
    """The file cannot be used; the message names the entry and what was expected."""


@dataclass(frozen=True, slots=True)
class CarCalibration:
    """All of a car: LiDAR, camera if there is one, antenna (3,), wheelbase, delays, and the LiDAR's spin if known."""

    vehicle: VehicleCalibration
    camera: CameraCalibration | None = None
    antenna_m: Vector = field(default_factory=lambda: np.zeros(3))
    wheelbase_m: float = WHEELBASE_M
    delays: SensorDelays = field(default_factory=SensorDelays)
    spin: Spin | None = None


def read_calibration(path: Path) -> CarCalibration:
    """The calibration in a TOML file; `CalibrationError` in one line if it cannot be read or makes no sense."""
    try:
        said = _File.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be read: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise CalibrationError(f"{path}: not TOML: {error}") from error
    except ValidationError as error:
        raise CalibrationError(f"{path}: {_in_words(error)}") from error
    return said.calibration()


def _in_words(error: ValidationError) -> str:
    first = error.errors(include_url=False)[0]
    entry = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        return f"{entry}: no such entry"
    if first["type"] == "missing":
        return f"{entry}: missing"
    return f"{entry}: {first['msg']}, not {first['input']!r}"


Metres = Annotated[float, Field(ge=-20, le=20)]
Degrees = Annotated[float, Field(ge=-360, le=360)]
Delay = Annotated[float, Field(ge=-1, le=1)]
Pixels = Annotated[float, Field(gt=0, le=100_000)]
Place = tuple[Metres, Metres, Metres]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, strict=True)


class _Mounted(_Table):
    place_m: Annotated[Place, Field(strict=False)]
    yaw_deg: Degrees = 0.0
    pitch_deg: Degrees = 0.0
    roll_deg: Degrees = 0.0

    def vehicle_from_mounted(self) -> Matrix:
        """Yaw to the left, then pitch nose down, then roll to the right side down (REP 103, intrinsic z-y-x)."""
        angles = [self.yaw_deg, self.pitch_deg, self.roll_deg]
        return rigid(Rotation.from_euler("ZYX", angles, degrees=True).as_matrix(), np.array(self.place_m))


class _Spin(_Table):
    rate_hz: Annotated[float, Field(ge=1, le=100)]
    direction: Literal["clockwise", "counterclockwise"]
    end_azimuth_deg: Degrees = 180.0


class _Lidar(_Mounted):
    sensor: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._:-]{0,63}$")]
    spin: _Spin | None = None


class _Camera(_Mounted):
    width_px: Annotated[int, Field(ge=16, le=20_000)]
    height_px: Annotated[int, Field(ge=16, le=20_000)]
    focal_px: Annotated[tuple[Pixels, Pixels], Field(strict=False)]
    centre_px: Annotated[tuple[Pixels, Pixels], Field(strict=False)]


class _Gnss(_Table):
    antenna_m: Annotated[Place, Field(strict=False)]


class _Vehicle(_Table):
    wheelbase_m: Annotated[float, Field(ge=0.5, le=20)] = WHEELBASE_M


class _Delays(_Table):
    gnss: Delay | None = None
    camera: Delay = 0.0
    motion: Delay = 0.0


class _File(_Table):
    lidar: _Lidar
    camera: _Camera | None = None
    gnss: _Gnss | None = None
    vehicle: _Vehicle = Field(default_factory=_Vehicle)
    delays_s: _Delays = Field(default_factory=_Delays)

    def calibration(self) -> CarCalibration:
        return CarCalibration(
            VehicleCalibration(self.lidar.vehicle_from_mounted(), self.lidar.sensor),
            None if self.camera is None else _camera(self.camera),
            np.zeros(3) if self.gnss is None else np.array(self.gnss.antenna_m),
            self.vehicle.wheelbase_m,
            SensorDelays(self.delays_s.gnss, self.delays_s.camera, self.delays_s.motion),
            None if self.lidar.spin is None else _spin(self.lidar.spin),
        )


def _camera(said: _Camera) -> CameraCalibration:
    (fx, fy), (cx, cy) = said.focal_px, said.centre_px
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    mounted = said.vehicle_from_mounted()
    vehicle_from_camera = rigid(mounted[:3, :3] @ AHEAD_FROM_CAMERA, mounted[:3, 3])
    return CameraCalibration(matrix, said.width_px, said.height_px, vehicle_from_camera)


def _spin(said: _Spin) -> Spin:
    return Spin(said.rate_hz, said.direction == "clockwise", math.radians(said.end_azimuth_deg))
