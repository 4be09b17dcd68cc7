"""Positions on the WGS 84 ellipsoid: distance (geodesic) and the plane about a report's origin."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from geographiclib.geodesic import Geodesic
from numpy.typing import NDArray

from contract.geometry import LatLon

FloatArray = NDArray[np.float64]

# A degree of latitude is nowhere shorter than this (110.57 km at the equator).
_LEAST_DEGREE_M = 110_574.0
_A_M, _FLATTENING = 6_378_137.0, 1 / 298.257223563
_B_M = _A_M * (1 - _FLATTENING)
_E2 = _FLATTENING * (2 - _FLATTENING)
_SECOND_E2 = _E2 / (1 - _E2)
_ECCENTRICITY = math.sqrt(_E2)
# Measured: 8e-9 m by floats, and up to 5 / (24 R^2) times the distance cubed, over the squared cosine of the latitude.
_LEAST_ERROR_M, _ERROR_PER_M2 = 1e-7, 1e-14
# Radii of curvature of the ellipsoid lie between 6335.4 and 6399.6 km: the sphere's distances are within 0.6 %.
_MEAN_RADIUS_M, _SPHERE_ERROR = 6_371_009.0, 0.01
_DEGREE_M = math.radians(_MEAN_RADIUS_M)
# Measured: there a plane's distances are the sphere's to 2 parts in 100,000.
_FLAT_WITHIN_M, _FLAT_TO_LATITUDE_DEG = 10_000.0, 85.0
# Vehicles report from a few thousand places at a time.
_REMEMBERED_PLANES = 4_096


class EastNorth(NamedTuple):
    """An offset in the plane of `enu` about an origin, metres."""

    east_m: float
    north_m: float


def distance_m(a: LatLon, b: LatLon) -> float:
    """Length of the geodesic between two positions (Karney 2013)."""
    solution = Geodesic.WGS84.Inverse(
        a.latitude_deg, a.longitude_deg, b.latitude_deg, b.longitude_deg, Geodesic.DISTANCE
    )
    return float(solution["s12"])


def is_within(a: LatLon, b: LatLon, radius_m: float) -> bool:
    """Whether two positions are at most `radius_m` apart; the geodesic decides only what the sphere cannot."""
    north_deg = b.latitude_deg - a.latitude_deg
    if abs(north_deg) * _LEAST_DEGREE_M > radius_m:
        return False
    apart_m = _apart_on_sphere_m(a, b, is_near=radius_m < _FLAT_WITHIN_M)
    if abs(apart_m - radius_m) > _SPHERE_ERROR * radius_m:
        return apart_m <= radius_m
    return distance_m(a, b) <= radius_m


def _apart_on_sphere_m(a: LatLon, b: LatLon, *, is_near: bool) -> float:
    """Distance on the mean sphere; as on a plane when it only matters whether it is less than `_FLAT_WITHIN_M`."""
    north_deg, east_deg = b.latitude_deg - a.latitude_deg, b.longitude_deg - a.longitude_deg
    if is_near and abs(a.latitude_deg) < _FLAT_TO_LATITUDE_DEG and abs(east_deg) < 180.0:
        middle_rad = math.radians(a.latitude_deg + north_deg / 2)
        return _DEGREE_M * math.hypot(north_deg, east_deg * math.cos(middle_rad))
    north_rad, east_rad = math.radians(north_deg), math.radians(east_deg)
    parallels = math.cos(math.radians(a.latitude_deg)) * math.cos(math.radians(b.latitude_deg))
    haversine = math.sin(north_rad / 2) ** 2 + parallels * math.sin(east_rad / 2) ** 2
    return 2 * _MEAN_RADIUS_M * math.asin(min(1.0, math.sqrt(haversine)))


def east_north_m(position: LatLon, origin: LatLon) -> EastNorth:
    """Offset of a position in the plane of `enu` about `origin`, both on the ellipsoid."""
    return _plane(origin.latitude_deg, origin.longitude_deg).offset_of(position)


def offset_from(origin: LatLon, east_m: float, north_m: float) -> LatLon:
    """The position at (east, north) of `enu` about `origin`; inverse of `east_north_m` to a micrometre within 500 m."""
    return _plane(origin.latitude_deg, origin.longitude_deg).position_at(east_m, north_m)


def mercator(latitude_deg: float, longitude_deg: float) -> complex:
    """Longitude, and the ellipsoid's isometric latitude as the imaginary part, in radians (Snyder 1987, eq. 3-7)."""
    sine = math.sin(math.radians(latitude_deg))
    return complex(math.radians(longitude_deg), math.atanh(sine) - _ECCENTRICITY * math.atanh(_ECCENTRICITY * sine))


class LocalMetric(NamedTuple):
    """Distances from a place, up to 85 degrees and a few km, from differences of `mercator`.

    The map is conformal: a short way is as long as its straight image, by the scale at its middle.
    """

    middle: complex
    """The place itself."""
    scale_m: float
    """Radius of its parallel: metres for a radian of the map."""
    sine: float
    """Of its latitude; the scale shrinks by it for each radian of isometric latitude."""

    def distance_m(self, other: complex) -> float:
        """Length of the geodesic to another place, wrong by `error_m` at most."""
        way = other - self.middle
        return abs(way) * self.scale_m * (1 - self.sine * way.imag / 2)

    def error_m(self, distance_m: float) -> float:
        """How far a distance may be off: it grows with the third power, and with the scale's bend."""
        return _LEAST_ERROR_M + _ERROR_PER_M2 * distance_m**3 / (1 - self.sine * self.sine)


def local_metric(place: LatLon) -> LocalMetric:
    """The metric about a place."""
    latitude_rad = math.radians(place.latitude_deg)
    sine = math.sin(latitude_rad)
    parallel_m = _A_M * math.cos(latitude_rad) / math.sqrt(1 - _E2 * sine * sine)
    return LocalMetric(mercator(place.latitude_deg, place.longitude_deg), parallel_m, sine)


class _Plane:
    """The tangent plane of the ellipsoid at an origin.

    By hand, since pymap3d's array functions take 100 to 250 us a call, a hundred times as long; a test holds this
    against them.
    """

    __slots__ = ("_cos_lat", "_cos_lon", "_origin_m", "_sin_lat", "_sin_lon")

    def __init__(self, latitude_deg: float, longitude_deg: float) -> None:
        latitude_rad, longitude_rad = math.radians(latitude_deg), math.radians(longitude_deg)
        self._sin_lat, self._cos_lat = math.sin(latitude_rad), math.cos(latitude_rad)
        self._sin_lon, self._cos_lon = math.sin(longitude_rad), math.cos(longitude_rad)
        self._origin_m = _earth_centred_m(latitude_deg, longitude_deg)

    def offset_of(self, position: LatLon) -> EastNorth:
        x_m, y_m, z_m = _earth_centred_m(position.latitude_deg, position.longitude_deg)
        from_x_m, from_y_m, from_z_m = self._origin_m
        dx_m, dy_m, dz_m = x_m - from_x_m, y_m - from_y_m, z_m - from_z_m
        outwards_m = self._cos_lon * dx_m + self._sin_lon * dy_m
        return EastNorth(
            -self._sin_lon * dx_m + self._cos_lon * dy_m, -self._sin_lat * outwards_m + self._cos_lat * dz_m
        )

    def position_at(self, east_m: float, north_m: float) -> LatLon:
        # The tangent plane leaves the ellipsoid by about d^2 / 2R; undoing it keeps the round trip exact.
        up_m = -(east_m**2 + north_m**2) / (2 * _MEAN_RADIUS_M)
        outwards_m = self._cos_lat * up_m - self._sin_lat * north_m
        return _position(
            self._origin_m[0] + self._cos_lon * outwards_m - self._sin_lon * east_m,
            self._origin_m[1] + self._sin_lon * outwards_m + self._cos_lon * east_m,
            self._origin_m[2] + self._sin_lat * up_m + self._cos_lat * north_m,
        )


@lru_cache(maxsize=_REMEMBERED_PLANES)
def _plane(latitude_deg: float, longitude_deg: float) -> _Plane:
    return _Plane(latitude_deg, longitude_deg)


@lru_cache(maxsize=_REMEMBERED_PLANES)
def _earth_centred_m(latitude_deg: float, longitude_deg: float) -> tuple[float, float, float]:
    """Earth-centred, earth-fixed coordinates of a position on the ellipsoid."""
    latitude_rad, longitude_rad = math.radians(latitude_deg), math.radians(longitude_deg)
    sine, cosine = math.sin(latitude_rad), math.cos(latitude_rad)
    normal_m = _A_M / math.sqrt(1 - _E2 * sine * sine)
    return (
        normal_m * cosine * math.cos(longitude_rad),
        normal_m * cosine * math.sin(longitude_rad),
        normal_m * (1 - _E2) * sine,
    )


def _position(x_m: float, y_m: float, z_m: float) -> LatLon:
    """The position below earth-centred coordinates near the ellipsoid (Bowring 1976: exact to a micrometre there)."""
    from_axis_m = math.hypot(x_m, y_m)
    parametric_rad = math.atan2(z_m * _A_M, from_axis_m * _B_M)
    latitude_rad = math.atan2(
        z_m + _SECOND_E2 * _B_M * math.sin(parametric_rad) ** 3,
        from_axis_m - _E2 * _A_M * math.cos(parametric_rad) ** 3,
    )
    longitude_deg = math.degrees(math.atan2(y_m, x_m))
    return LatLon(latitude_deg=math.degrees(latitude_rad), longitude_deg=(longitude_deg + 180.0) % 360.0 - 180.0)
