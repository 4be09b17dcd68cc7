"""A satellite receiver: fixes whose error wanders slowly, with noise on top and, if wanted, times without a fix."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from simulator.readings import GnssReading, SensorName
from simulator.streets.street import GeoReference

FloatArray = NDArray[np.float64]
Enu = tuple[float, float, float]

GNSS = SensorName("sensor.other.gnss", "gnss")

WGS84_SEMI_MAJOR_M = 6_378_137.0
WGS84_ECCENTRICITY_SQUARED = 6.694_379_990_14e-3


class GnssError(Protocol):
    """How wrong a receiver is; what it means in metres may depend on where it is used."""

    def at(self, latitude_deg: float) -> GnssModel:
        """The same errors in metres at a latitude."""
        ...


@dataclass(frozen=True, slots=True)
class GnssModel:
    """Errors along east, north and up: a constant, a first-order Gauss-Markov process, and white noise.

    The process keeps `bias_sd_m` at all times and forgets with exp(-t / bias_time_s): orbit, clock, atmosphere and
    multipath (Rankin, An error model for sensor simulation: GPS and differential GPS, IEEE PLANS 1994). The values
    agree with a consumer receiver against a refined trajectory (docs/sensors.md). Outages begin at random, on
    average `outage_every_s` after the last one ended, and last `outage_lasts_s` on average.
    """

    bias_sd_m: Enu = (1.2, 1.2, 2.0)
    bias_time_s: float = 600.0
    noise_sd_m: Enu = (0.1, 0.1, 0.1)
    offset_m: Enu = (0.0, 0.0, 0.0)
    outage_every_s: float = math.inf
    outage_lasts_s: float = 0.0

    def __post_init__(self) -> None:
        deviations = (*self.bias_sd_m, *self.noise_sd_m, self.outage_lasts_s)
        if not all(0 <= value < math.inf for value in deviations) or not all(map(math.isfinite, self.offset_m)):
            raise ValueError("a receiver's deviations are not negative, its offsets finite")
        if not (self.bias_time_s > 0 and self.outage_every_s > 0):
            raise ValueError("a receiver's times are positive")

    def at(self, latitude_deg: float) -> GnssModel:
        """Itself: metres are metres everywhere."""
        return self

    @property
    def total_sd_m(self) -> FloatArray:
        """Standard deviation (3,) of a single fix's error about the constant offset."""
        return np.hypot(self.bias_sd_m, self.noise_sd_m)


@dataclass(frozen=True, slots=True)
class CarlaGnss:
    """CARLA's receiver: white noise and a constant, for latitude and longitude in degrees, for altitude in metres."""

    latitude_sd_deg: float = 0.0
    longitude_sd_deg: float = 0.0
    altitude_sd_m: float = 0.0
    latitude_bias_deg: float = 0.0
    longitude_bias_deg: float = 0.0
    altitude_bias_m: float = 0.0

    def at(self, latitude_deg: float) -> GnssModel:
        """The same errors in metres at a latitude."""
        east, north = metres_per_degree(latitude_deg)
        return GnssModel(
            bias_sd_m=(0.0, 0.0, 0.0),
            noise_sd_m=(self.longitude_sd_deg * east, self.latitude_sd_deg * north, self.altitude_sd_m),
            offset_m=(self.longitude_bias_deg * east, self.latitude_bias_deg * north, self.altitude_bias_m),
        )


def metres_per_degree(latitude_deg: float) -> tuple[float, float]:
    """Length on the WGS 84 ellipsoid of a degree of longitude and of one of latitude (its radii of curvature)."""
    latitude = math.radians(latitude_deg)
    flat = 1 - WGS84_ECCENTRICITY_SQUARED * math.sin(latitude) ** 2
    prime_vertical_m = WGS84_SEMI_MAJOR_M / math.sqrt(flat)
    meridian_m = WGS84_SEMI_MAJOR_M * (1 - WGS84_ECCENTRICITY_SQUARED) / flat**1.5
    return math.radians(1) * prime_vertical_m * math.cos(latitude), math.radians(1) * meridian_m


@dataclass
class GnssReceiver:
    """A receiver in use: it remembers its error from fix to fix, so that two on the road err apart."""

    error: GnssError
    georeference: GeoReference
    enu_from_street: FloatArray
    rng: np.random.Generator
    sensor: SensorName = GNSS
    _model: GnssModel = field(init=False)
    _bias_m: FloatArray = field(init=False)
    _time_s: float = field(init=False, default=-math.inf)
    _outage_from_s: float = field(init=False, default=-math.inf)
    _outage_until_s: float = field(init=False, default=-math.inf)

    def __post_init__(self) -> None:
        self._model = self.error.at(self.georeference.position.latitude_deg)
        self._bias_m = self.rng.standard_normal(3) * self._model.bias_sd_m

    def measure(self, street_from_antenna: FloatArray, time_s: float) -> GnssReading | None:
        """The fix at a time later than the last one, `street_from_antenna` (4, 4); None during an outage."""
        if not time_s > self._time_s:
            raise ValueError(f"a fix at {time_s} s cannot follow one at {self._time_s} s")
        self._let_pass(time_s)
        noise_m = self.rng.standard_normal(3) * self._model.noise_sd_m
        if self._outage_from_s <= time_s < self._outage_until_s:
            return None
        enu_m = (self.enu_from_street @ street_from_antenna[:, 3])[:3] + self._model.offset_m + self._bias_m + noise_m
        position, altitude_m = self.georeference.geodetic_from_enu(enu_m)
        east, north, up = self._model.total_sd_m
        return GnssReading(self.sensor, time_s, position, altitude_m, math.hypot(east, north) / math.sqrt(2), float(up))

    def _let_pass(self, time_s: float) -> None:
        """The bias after the time since the last fix, by the exact transition of the process; the next outage."""
        kept = math.exp(-(time_s - self._time_s) / self._model.bias_time_s)
        fresh = self.rng.standard_normal(3) * self._model.bias_sd_m
        self._bias_m = kept * self._bias_m + math.sqrt(1 - kept**2) * fresh
        if math.isfinite(self._model.outage_every_s) and time_s >= self._outage_until_s:
            self._outage_from_s = time_s + self.rng.exponential(self._model.outage_every_s)
            self._outage_until_s = self._outage_from_s + self.rng.exponential(self._model.outage_lasts_s)
        self._time_s = time_s
