"""CARLA's sensor blueprints: attributes with the defaults that version 0.9.16 documents, and what they mean here.

Attributes may be numbers or their text, as CARLA takes them. Ours alone: `headsup_preset` replaces the attributes of a
LiDAR or GNSS receiver by those of a sensor that exists.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from simulator.recording.handedness import CarlaTransform, right_handed_transform
from simulator.sensors.camera import CameraModel
from simulator.sensors.gnss import CarlaGnss, GnssError, GnssModel
from simulator.sensors.imu import ImuModel
from simulator.sensors.lidar import LidarModel
from simulator.sensors.lidar_presets import LIDAR_PRESETS
from simulator.sensors.returns import CarlaReturns

FloatArray = NDArray[np.float64]

VEHICLE_FROM_FORWARD_OPTICS = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""A mounting frame (x forward, y left, z up) from its camera's (x right, y down, z forward)."""

CAMERA_LOOK = frozenset(
    {
        *("bloom_intensity", "fstop", "iso", "gamma"),
        *("lens_flare_intensity", "shutter_speed", "lens_circle_falloff", "lens_circle_multiplier"),
        *("lens_k", "lens_kcube", "lens_x_size", "lens_y_size"),
        *("min_fstop", "blade_count", "exposure_mode", "exposure_compensation"),
        *("exposure_min_bright", "exposure_max_bright", "exposure_speed_up", "exposure_speed_down"),
        *("calibration_constant", "focal_distance", "blur_amount", "blur_radius"),
        *("motion_blur_intensity", "motion_blur_max_distortion", "motion_blur_min_object_screen_size", "slope"),
        *("toe", "shoulder", "black_clip", "white_clip"),
        *("temp", "tint", "chromatic_aberration_intensity", "chromatic_aberration_offset"),
        "enable_postprocess_effects",
    }
)
"""Attributes of CARLA's cameras that are accepted and have no effect here."""

Share = Annotated[float, Field(ge=0, le=1)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


# Far more than any sensor has, and little enough for memory and for float32.
Pixels = Annotated[int, Field(gt=0, le=8_192)]
Metres = Annotated[float, Field(ge=-100, le=100, allow_inf_nan=False)]


class Mounting(_Strict):
    """CARLA's left-handed pose on the vehicle: metres and degrees."""

    x: Metres = 0.0
    y: Metres = 0.0
    z: Metres = 0.0
    roll: Finite = 0.0
    pitch: Finite = 0.0
    yaw: Finite = 0.0

    @property
    def vehicle_from_sensor(self) -> FloatArray:
        """(4, 4), right-handed."""
        return right_handed_transform(CarlaTransform(self.x, self.y, self.z, self.pitch, self.yaw, self.roll))


class _Sensor(_Strict):
    # It names a folder where two sensors share a type.
    role_name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
    transform: Annotated[tuple[Mounting, ...], Field(min_length=1, max_length=1)] = (Mounting(),)
    sensor_tick: NotNegative = 0.0
    noise_seed: int = 0

    @property
    def tick_s(self) -> float:
        """Time between two measurements; 0 for every frame of the world."""
        return self.sensor_tick


class _Camera(_Sensor):
    # What CARLA's lens and film can do beyond a pinhole has no counterpart here; a set-up made for CARLA may state it.
    @model_validator(mode="before")
    @classmethod
    def _without_look(cls, entry: dict[str, Any]) -> dict[str, Any]:
        return {key: value for key, value in entry.items() if key not in CAMERA_LOOK}

    image_size_x: Pixels = 800
    image_size_y: Pixels = 600
    fov: Annotated[float, Field(gt=0, lt=180)] = 90.0

    def model(self) -> CameraModel:
        """Its pinhole."""
        mounting = self.transform[0].vehicle_from_sensor
        return CameraModel(
            self.image_size_x, self.image_size_y, math.radians(self.fov), mounting @ VEHICLE_FROM_FORWARD_OPTICS
        )


class RgbCamera(_Camera):
    """`sensor.camera.rgb`."""

    type: Literal["sensor.camera.rgb"]


class SemanticCamera(_Camera):
    """`sensor.camera.semantic_segmentation`."""

    type: Literal["sensor.camera.semantic_segmentation"]


class _RayCast(_Sensor):
    channels: Annotated[int, Field(gt=0, le=512)] = 32
    range: Annotated[float, Field(gt=0, le=1_000)] = 10.0
    points_per_second: Annotated[int, Field(gt=0, le=50_000_000)] = 56_000
    rotation_frequency: Positive = 10.0
    upper_fov: Annotated[float, Field(ge=-90, le=90)] = 10.0
    lower_fov: Annotated[float, Field(ge=-90, le=90)] = -30.0
    horizontal_fov: Annotated[float, Field(ge=360, le=360)] = 360.0

    @property
    def tick_s(self) -> float:
        """Time between two turns."""
        return self.sensor_tick or 1 / self.rotation_frequency

    def _model(self, range_sd_m: float, returns: CarlaReturns) -> LidarModel:
        return LidarModel(
            channels=self.channels,
            upper_elevation_rad=math.radians(self.upper_fov),
            lower_elevation_rad=math.radians(self.lower_fov),
            range_m=self.range,
            points_per_second=self.points_per_second,
            rate_hz=self.rotation_frequency,
            height_m=self.transform[0].z,
            range_sd_m=range_sd_m,
            returns=returns,
        )


class RayCastLidar(_RayCast):
    """`sensor.lidar.ray_cast`, or with `headsup_preset` a sensor of `LIDAR_PRESETS`."""

    type: Literal["sensor.lidar.ray_cast"]
    atmosphere_attenuation_rate: NotNegative = 0.004
    dropoff_general_rate: Share = 0.45
    dropoff_intensity_limit: Share = 0.8
    dropoff_zero_intensity: Share = 0.4
    noise_stddev: NotNegative = 0.0
    headsup_preset: Literal["paper", "hdl64", "hdl32", "carla"] | None = None

    @property
    def tick_s(self) -> float:
        """Time between two turns."""
        return self.sensor_tick or 1 / self.model().rate_hz

    def model(self) -> LidarModel:
        """What it measures."""
        if self.headsup_preset is not None:
            return replace(LIDAR_PRESETS[self.headsup_preset](), height_m=self.transform[0].z)
        return self._model(
            self.noise_stddev,
            CarlaReturns(
                self.atmosphere_attenuation_rate,
                self.dropoff_general_rate,
                self.dropoff_intensity_limit,
                self.dropoff_zero_intensity,
            ),
        )


class SemanticLidar(_RayCast):
    """`sensor.lidar.ray_cast_semantic`: exact, and every ray that hits returns."""

    type: Literal["sensor.lidar.ray_cast_semantic"]

    def model(self) -> LidarModel:
        """What it measures."""
        return self._model(0.0, CarlaReturns())


class Gnss(_Sensor):
    """`sensor.other.gnss`, or with `headsup_preset` "receiver" one whose error wanders (`GnssModel`)."""

    type: Literal["sensor.other.gnss"]
    noise_alt_bias: Finite = 0.0
    noise_alt_stddev: NotNegative = 0.0
    noise_lat_bias: Finite = 0.0
    noise_lat_stddev: NotNegative = 0.0
    noise_lon_bias: Finite = 0.0
    noise_lon_stddev: NotNegative = 0.0
    headsup_preset: Literal["receiver"] | None = None

    def model(self) -> GnssError:
        """How wrong it is."""
        if self.headsup_preset is not None:
            return GnssModel()
        return CarlaGnss(
            latitude_sd_deg=self.noise_lat_stddev,
            longitude_sd_deg=self.noise_lon_stddev,
            altitude_sd_m=self.noise_alt_stddev,
            latitude_bias_deg=self.noise_lat_bias,
            longitude_bias_deg=self.noise_lon_bias,
            altitude_bias_m=self.noise_alt_bias,
        )


class Imu(_Sensor):
    """`sensor.other.imu`; CARLA's axes have y to the right, ours to the left. The compass' noise, degrees, is ours."""

    type: Literal["sensor.other.imu"]
    noise_accel_stddev_x: NotNegative = 0.0
    noise_accel_stddev_y: NotNegative = 0.0
    noise_accel_stddev_z: NotNegative = 0.0
    noise_gyro_bias_x: Finite = 0.0
    noise_gyro_bias_y: Finite = 0.0
    noise_gyro_bias_z: Finite = 0.0
    noise_gyro_stddev_x: NotNegative = 0.0
    noise_gyro_stddev_y: NotNegative = 0.0
    noise_gyro_stddev_z: NotNegative = 0.0
    headsup_compass_stddev: NotNegative = 0.0

    def model(self) -> ImuModel:
        """How wrong it is."""
        # Mirroring y turns rotations about x and z round, and keeps those about y.
        return ImuModel(
            (self.noise_accel_stddev_x, self.noise_accel_stddev_y, self.noise_accel_stddev_z),
            (self.noise_gyro_stddev_x, self.noise_gyro_stddev_y, self.noise_gyro_stddev_z),
            (-self.noise_gyro_bias_x, self.noise_gyro_bias_y, -self.noise_gyro_bias_z),
            math.radians(self.headsup_compass_stddev),
        )


Blueprint = Annotated[
    RgbCamera | SemanticCamera | RayCastLidar | SemanticLidar | Gnss | Imu, Field(discriminator="type")
]
"""An entry of `sensors.json`."""
