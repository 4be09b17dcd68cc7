"""Positions on the WGS 84 ellipsoid: distance (geodesic) and the plane about a report's origin."""

from __future__ import annotations

import math

import numpy as np
import pymap3d
from geographiclib.geodesic import Geodesic
from numpy.typing import NDArray

from contract.geometry import LatLon, PlaneCovariance

FloatArray = NDArray[np.float64]

# A degree of latitude is nowhere shorter than this (110.57 km at the equator).
_LEAST_DEGREE_M = 110_574.0


def distance_m(a: LatLon, b: LatLon) -> float:
    """Length of the geodesic between two positions (Karney 2013)."""
    solution = Geodesic.WGS84.Inverse(
        a.latitude_deg, a.longitude_deg, b.latitude_deg, b.longitude_deg, Geodesic.DISTANCE
    )
    return float(solution["s12"])


def is_within(a: LatLon, b: LatLon, radius_m: float) -> bool:
    """Whether two positions are at most `radius_m` apart; cheap when their latitudes already say no."""
    if abs(a.latitude_deg - b.latitude_deg) * _LEAST_DEGREE_M > radius_m:
        return False
    return distance_m(a, b) <= radius_m


def east_north_m(position: LatLon, origin: LatLon) -> FloatArray:
    """Offsets (2,) of a position in the plane of `enu` about `origin`, both on the ellipsoid."""
    east_m, north_m, _ = pymap3d.geodetic2enu(
        position.latitude_deg, position.longitude_deg, 0.0, origin.latitude_deg, origin.longitude_deg, 0.0
    )
    return np.array([east_m, north_m], dtype=np.float64)


def offset_from(origin: LatLon, offset_m: FloatArray) -> LatLon:
    """The position at (east, north) of `enu` about `origin`; inverse of `east_north_m` to a micrometre within 500 m."""
    east_m, north_m = float(offset_m[0]), float(offset_m[1])
    # The tangent plane leaves the ellipsoid by d^2 / 2R; undoing it keeps the round trip exact.
    up_m = -(east_m**2 + north_m**2) / (2 * 6_371_009.0)
    latitude_deg, longitude_deg, _ = pymap3d.enu2geodetic(
        east_m, north_m, up_m, origin.latitude_deg, origin.longitude_deg, 0.0
    )
    return LatLon(latitude_deg=float(latitude_deg), longitude_deg=_wrapped_deg(float(longitude_deg)))


def matrix_m2(covariance: PlaneCovariance) -> FloatArray:
    """Covariance as a (2, 2) matrix of (east, north)."""
    cross = covariance.east_north_m2
    return np.array([[covariance.east_m2, cross], [cross, covariance.north_m2]], dtype=np.float64)


def covariance_of(matrix: FloatArray) -> PlaneCovariance:
    """A (2, 2) positive semi-definite matrix as a covariance."""
    east_m2, north_m2 = float(matrix[0, 0]), float(matrix[1, 1])
    limit = math.sqrt(east_m2 * north_m2)
    return PlaneCovariance(
        east_m2=east_m2, north_m2=north_m2, east_north_m2=max(-limit, min(limit, float(matrix[0, 1])))
    )


def _wrapped_deg(longitude_deg: float) -> float:
    return (longitude_deg + 180.0) % 360.0 - 180.0
