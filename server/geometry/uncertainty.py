"""The error ellipse of a position. Pure."""

from __future__ import annotations

import math
from typing import NamedTuple

from contract.geometry import PlaneCovariance


class ErrorEllipse(NamedTuple):
    """Standard deviations along the axes; `azimuth_rad` of the major one, clockwise from north, in [0, pi)."""

    major_sd_m: float
    minor_sd_m: float
    azimuth_rad: float


def error_ellipse(covariance: PlaneCovariance) -> ErrorEllipse:
    """Principal axes of a covariance of (east, north)."""
    middle = (covariance.east_m2 + covariance.north_m2) / 2
    half_difference = (covariance.east_m2 - covariance.north_m2) / 2
    spread = math.hypot(half_difference, covariance.east_north_m2)
    yaw_rad = math.atan2(covariance.east_north_m2, half_difference) / 2
    return ErrorEllipse(
        major_sd_m=math.sqrt(middle + spread),
        minor_sd_m=math.sqrt(max(0.0, middle - spread)),
        azimuth_rad=(math.pi / 2 - yaw_rad) % math.pi,
    )
