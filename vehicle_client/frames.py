"""Conversions between frames (`docs/frames.md`): headings, rigid transforms, WGS 84 and local east-north-up."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pymap3d
from numpy.typing import NDArray

from contract.geometry import LatLon

Matrix = NDArray[np.float64]
Vector = NDArray[np.float64]


def yaw_from_heading(heading_rad: float) -> float:
    """Yaw counter-clockwise from east, in (-pi, pi], of a heading clockwise from north."""
    yaw = (math.pi / 2 - heading_rad) % (2 * math.pi)
    return yaw - 2 * math.pi if yaw > math.pi else yaw


def heading_from_yaw(yaw_rad: float) -> float:
    """Heading clockwise from north, in [0, 2 pi), of a yaw counter-clockwise from east."""
    heading = (math.pi / 2 - yaw_rad) % (2 * math.pi)
    return 0.0 if heading >= 2 * math.pi else heading


def axis_yaw(yaw_rad: float) -> float:
    """Yaw of a direction that has no front (the length of a box), in [0, pi)."""
    yaw = yaw_rad % math.pi
    # The remainder of a tiny negative number rounds up to pi itself.
    return 0.0 if yaw >= math.pi else yaw


def yaw_of(a_from_b: Matrix) -> float:
    """Yaw of frame b in frame a, radians, of a (4, 4) rigid transform."""
    return math.atan2(a_from_b[1, 0], a_from_b[0, 0])


def rotation_about_z(yaw_rad: float) -> Matrix:
    """(3, 3) rotation by a yaw."""
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def rigid(rotation: Matrix, translation_m: Vector) -> Matrix:
    """(4, 4) transform of a (3, 3) rotation and a (3,) translation."""
    transform = np.eye(4)
    transform[:3, :3] = rotation
    transform[:3, 3] = translation_m
    return transform


def inverse(a_from_b: Matrix) -> Matrix:
    """b_from_a of a (4, 4) rigid transform."""
    rotation = a_from_b[:3, :3].T
    return rigid(rotation, -rotation @ a_from_b[:3, 3])


def apply(a_from_b: Matrix, points_b: NDArray[np.floating]) -> Matrix:
    """Points (N, 3) or (3,) of frame b in frame a."""
    return np.asarray(points_b, dtype=np.float64) @ a_from_b[:3, :3].T + a_from_b[:3, 3]


@dataclass(frozen=True, slots=True)
class GeoOrigin:
    """Where a local `enu` frame touches the earth."""

    position: LatLon
    altitude_m: float

    def enu(self, position: LatLon, altitude_m: float) -> Vector:
        """East, north, up in metres of a WGS 84 position, (3,)."""
        origin = self.position
        return np.array(
            pymap3d.geodetic2enu(
                position.latitude_deg,
                position.longitude_deg,
                altitude_m,
                origin.latitude_deg,
                origin.longitude_deg,
                self.altitude_m,
            ),
            dtype=np.float64,
        )

    def geodetic(self, enu_m: Vector) -> tuple[LatLon, float]:
        """WGS 84 position and ellipsoidal height of a point (3,) in `enu`."""
        origin = self.position
        latitude, longitude, altitude = pymap3d.enu2geodetic(
            *(float(v) for v in enu_m), origin.latitude_deg, origin.longitude_deg, self.altitude_m
        )
        return LatLon(latitude_deg=float(latitude), longitude_deg=float(longitude)), float(altitude)
