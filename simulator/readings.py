"""What the sensors of one vehicle say at one moment, and the truth beside it: what recordings are written from.

Frames are ours (right-handed, REP 103); only the writer of CARLA's layout knows of left-handed axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from contract.geometry import Kind, LatLon

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Sweep:
    """One turn of a LiDAR: the returns in the order they were fired (by azimuth, then ring), and the truth of each.

    `points_m` (N, 3) float32, frame `sensor` at the moment each was fired: a moving sensor distorts them, as a real
    one does; `time_offset_s` (N,) says when, relative to the turn's stamp, its end: never positive. `ring` (N,), 0
    looks down most; `azimuth_rad` (N,) counter-clockwise from ahead; `intensity` (N,) in [0, 1]; `cos_incidence` (N,)
    of the angle between ray and surface normal. Truth: `surface` (N,) holds `Surface` values, `obstacle_id` (N,) the
    obstacle's number or 0, `mover_id` (N,) the moving thing's number or 0.
    """

    points_m: NDArray[np.float32]
    ring: NDArray[np.uint16]
    azimuth_rad: NDArray[np.float32]
    time_offset_s: NDArray[np.float32]
    intensity: NDArray[np.float32]
    cos_incidence: NDArray[np.float32]
    surface: NDArray[np.uint8]
    obstacle_id: NDArray[np.int32]
    mover_id: NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class SensorName:
    """CARLA's type, such as `sensor.lidar.ray_cast`, and the name that tells two of a type apart."""

    type: str
    role: str


@dataclass(frozen=True, slots=True)
class LidarReading:
    """A turn that ended at the frame's time; `street_from_sensor` (4, 4) is the exact pose at that time."""

    sensor: SensorName
    street_from_sensor: FloatArray
    sweep: Sweep


@dataclass(frozen=True, slots=True)
class ImageReading:
    """A picture: `pixels` (H, W, 3) uint8 BGR, or (H, W) uint8 of CARLA's semantic tags.

    `street_from_sensor` (4, 4) is the pose of the camera's mounting frame: x forward, y left, z up.
    """

    sensor: SensorName
    street_from_sensor: FloatArray
    pixels: NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class GnssReading:
    """A satellite fix of the antenna; `sd_m` and `altitude_sd_m` (1 sigma) are what the receiver states."""

    sensor: SensorName
    time_s: float
    position: LatLon
    altitude_m: float
    sd_m: float
    altitude_sd_m: float


@dataclass(frozen=True, slots=True)
class ImuReading:
    """Specific force (3,) m/s^2 and angular rate (3,) rad/s about the sensor's axes; heading clockwise from north."""

    sensor: SensorName
    time_s: float
    accelerometer_mps2: FloatArray
    gyroscope_radps: FloatArray
    compass_rad: float


Reading = LidarReading | ImageReading | GnssReading | ImuReading


@dataclass(frozen=True, slots=True)
class EgoFrame:
    """One frame of one vehicle: the world's tick, the exact state, and every reading since the frame before it.

    `street_from_vehicle` and `enu_from_vehicle` (4, 4) are exact; `odom_from_vehicle` (4, 4) is what wheels and gyro
    say, smooth and drifting; `steering_rad` is the front wheels' angle, positive to the left.
    """

    number: int
    time_s: float
    street_from_vehicle: FloatArray
    enu_from_vehicle: FloatArray
    odom_from_vehicle: FloatArray
    speed_mps: float
    steering_rad: float
    readings: tuple[Reading, ...]


@dataclass(frozen=True, slots=True)
class ObstacleTruth:
    """One obstacle as it is from `from_s` on, until a later row of the same number replaces it.

    `change` says why the row begins: `initial`, `appeared`, `grown` or `removed` (filled, or taken away: its sizes are
    those it had). Position of the middle of the footprint at the height of the sound road; yaw counter-clockwise from
    east; sizes as in the shape: extents along and across its own axes, greatest depth or height, all positive.
    """

    obstacle_id: int
    kind: Kind
    change: str
    from_s: float
    position: LatLon
    altitude_m: float
    enu_m: tuple[float, float, float]
    yaw_rad: float
    length_m: float
    width_m: float
    relief_m: float
    area_m2: float
    volume_m3: float
