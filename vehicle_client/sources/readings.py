"""What sensors say, one value each: a recording or a live stream is a sequence of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vehicle_client.frames import Matrix
from vehicle_client.sources.frame import GnssFix, LidarFrame, Motion


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture of the forward camera, not decoded yet: of three, two are never looked at."""

    stamp_s: float
    decode: Callable[[], NDArray[np.uint8]]
    """(H, W, 3) uint8 BGR; raises `SourceError` where the picture is not whole."""


@dataclass(frozen=True, slots=True)
class Heading:
    """Where an inertial unit says the car points, clockwise from north."""

    stamp_s: float
    heading_rad: float


@dataclass(frozen=True, slots=True)
class GroundVelocity:
    """Velocity over ground as satellite receivers measure it."""

    stamp_s: float
    course_rad: float
    """Clockwise from north."""
    speed_mps: float


@dataclass(frozen=True, slots=True)
class Odometry:
    """`odom_from_vehicle` (4, 4) at a moment."""

    stamp_s: float
    odom_from_vehicle: Matrix
    speed_mps: float | None = None


@dataclass(frozen=True, slots=True)
class Steering:
    """Angle of the front wheels, positive to the left."""

    stamp_s: float
    steering_rad: float


Reading = LidarFrame | Picture | GnssFix | Heading | GroundVelocity | Motion | Odometry | Steering
"""A `LidarFrame` here is a sweep alone: stamp, points, intensity, ring and times."""
