"""Numbers that a message says, taken only where they can be true."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from contract.geometry import LatLon
from vehicle_client.frames import Matrix, rigid
from vehicle_client.sources.frame import GnssFix, SourceError

CLOCKS_AGREE_S = 10.0
"""A message's own stamp counts if it is so near to when it was recorded: else the sensor's clock is not set (it counts
from its start), or the recording is of a simulated time that other topics do not share."""

UNIX_SINCE_S = 1e9
"""2001: a log time before it is none, and some writers leave it at 0."""

UNSTATED_SD_M = 5.0
"""Horizontal error of a receiver that states none: single frequency, open sky, without corrections, 95 % in 10 m."""

LEAST_SD_M = 0.005
"""No receiver knows its place better; some state 0."""

FARTHEST_M = 1e7
"""No pose by odometry lies farther from where the drive began."""


def finite(value: object) -> float:
    """A number; `SourceError` if it is none, or not finite."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise SourceError(f"{str(value)[:40]} is not a finite number")
    return float(value)


def checked_stamp(own_s: float, log_s: float) -> float:
    """Unix time of a message: its own stamp, or that of its recording where the two disagree and both can be."""
    return own_s if abs(own_s - log_s) <= CLOCKS_AGREE_S or log_s < UNIX_SINCE_S else log_s


def checked_pose(position_m: Sequence[float], quaternion_xyzw: Sequence[float]) -> Matrix:
    """(4, 4) of a place and a unit quaternion; `SourceError` if it is none."""
    values = np.array([*position_m, *quaternion_xyzw], dtype=np.float64)
    if not np.isfinite(values).all() or np.abs(values[:3]).max() > FARTHEST_M:
        raise SourceError("a pose that is not finite")
    # Drivers that know no attitude send zeros.
    if abs(np.linalg.norm(values[3:]) - 1) > 0.01:
        raise SourceError("an attitude that is no unit quaternion")
    return rigid(Rotation.from_quat(values[3:]).as_matrix(), values[:3])


def checked_fix(stamp_s: float, place: tuple[float, float, float], covariance_m2: Sequence[float]) -> GnssFix:
    """A fix from latitude, longitude (degrees) and altitude (m), and a covariance (9,), row by row, east, north, up.

    An empty covariance is one that is not known. `SourceError` if it is no place on earth.
    """
    latitude, longitude, altitude = (finite(value) for value in place)
    if abs(latitude) > 90 or abs(longitude) > 180 or (latitude, longitude) == (0.0, 0.0):
        raise SourceError(f"a fix at latitude {latitude}, longitude {longitude}")
    sd_m, altitude_sd_m = UNSTATED_SD_M, 2 * UNSTATED_SD_M
    if len(covariance_m2) == 9:
        horizontal, vertical = (covariance_m2[0] + covariance_m2[4]) / 2, covariance_m2[8]
        if not (math.isfinite(horizontal) and math.isfinite(vertical) and horizontal >= 0 and vertical >= 0):
            raise SourceError("a fix whose covariance is not finite")
        sd_m, altitude_sd_m = (max(math.sqrt(v), LEAST_SD_M) for v in (horizontal, vertical))
    position = LatLon(latitude_deg=latitude, longitude_deg=longitude)
    return GnssFix(position, altitude, None, sd_m, altitude_sd_m, stamp_s=stamp_s)
