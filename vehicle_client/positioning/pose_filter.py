"""The car in the plane: place, heading, and what odometry and satellites get wrong, by a bank of Kalman filters.

A receiver says how large its error is, not how long it lasts, and that decides what averaging is worth: white noise
vanishes, an error that lasts minutes stays. So one filter runs for each of `ERROR_MODELS`, and each counts by how well
it foretold the fixes (Magill, Optimal adaptive estimation of sampled stochastic processes, IEEE TAC 10(4), 1965). The
filters share their shape: fix = place a delay ago + slow error + white noise, where the slow error is a first-order
Gauss-Markov process (Rankin, An error model for sensor simulation: GPS and differential GPS, IEEE PLANS 1994). A delay
puts the car behind itself by its way in that time: that grows with speed and turns with the car, which no slow error of
a receiver does, and so both come apart when the car brakes or turns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from vehicle_client.frames import Matrix, Vector

STATES = 8
EAST, NORTH, YAW, SCALE, TURN, SLOW_EAST, SLOW_NORTH, DELAY = range(STATES)
"""The state: metres, metres, radians, odometry's scale error, its false turn (rad/m), slow errors in units of the
fix's stated deviation, seconds from the moment of a fix to its stamp."""

SLOW = slice(SLOW_EAST, SLOW_NORTH + 1)


@dataclass(frozen=True, slots=True)
class ErrorModel:
    """Of a fix's stated deviation, the share that is new with every fix, and the memory of the rest."""

    white: float
    memory_s: float

    @property
    def slow(self) -> float:
        """Share of the slow error; the squares of both make one."""
        return math.sqrt(1 - self.white**2)


ERROR_MODELS = (
    *(ErrorModel(0.1, memory_s) for memory_s in (30.0, 100.0, 600.0)),
    *(ErrorModel(white, memory_s) for white in (0.3, 0.6, 0.9) for memory_s in (30.0, 100.0)),
    ErrorModel(1.0, math.inf),
)
"""Multipath of a moving car lasts tens of seconds, atmosphere and orbits minutes (Rankin). Receivers that smooth leave
a tenth of white noise; simulators know white noise alone."""

FORGET_S = 300.0
"""Memory of which model was right: streets change from open to built up within minutes."""

LEAST_WEIGHT = 1e-4
"""No model is ruled out for good."""

DELAY_SD_S = 0.1
"""What stamps may be off as a whole: nothing where receivers stamp; where arrival is the stamp, autopilots allow u-blox
receivers 95 ms (openpilot) to 110 ms (PX4's EKF2_GPS_DELAY)."""

KNOWN_DELAY_SD_S = 0.02
"""The same where somebody has measured the delay: to the jitter of a fix's stamp."""

DELAY_LASTS_S = 36_000.0
"""A delay is its device's, and changes with the load on it: over a working day, not over a street."""

STAMP_SD_S = 0.02
"""Jitter of a fix's stamp where it is taken on arrival: serial lines and schedulers add 10 to 30 ms."""


SCALE_SD = 0.01
"""What odometry gets wrong for a whole drive, 1 sigma: 1 % of the way, from tyres' wear and pressure. KITTI's odometry
table has 0.5 to 2 % for scan matching and cameras."""

TURN_SD_RAD_PER_M = math.radians(0.01)
"""And 1 degree in 100 m, from gyros and steering that are not at zero; KITTI's table has 0.1 to 1 degree."""

CONSTANTS_LAST_M = 2_000.0
"""Tyres warm up, gyros drift: after some kilometres both are others."""

WAY_SD_M, YAW_SD_RAD = 0.02, math.radians(0.03)
"""Noise after a metre, growing with the root of the way: 20 cm and 0.3 degrees in 100 m."""

YAW_SD_PER_TURN = 0.03
"""Of a turn itself: a gyro's scale, tyres that slip outwards."""


@dataclass(frozen=True, slots=True)
class PlaneFilter:
    """A bank of M filters: means (M, 8), covariances (M, 8, 8), weights (M,) that sum to one."""

    mean: Matrix
    covariance: Matrix
    weight: Vector

    @property
    def state(self) -> Vector:
        """The mixture's mean (8,)."""
        return np.asarray(self.weight @ self.mean)

    @property
    def state_covariance(self) -> Matrix:
        """The mixture's covariance (8, 8): that of each, and how far they are apart."""
        apart = self.mean - self.state
        spread = np.einsum("m,mi,mj->ij", self.weight, apart, apart)
        return np.asarray(np.einsum("m,mij->ij", self.weight, self.covariance) + spread)


ANYWHERE_SD_M = 1_000.0
"""Of a place before its first fix: so much larger than a receiver's error that only the fix counts."""


def started(fix: PlaceMeasurement, yaw_rad: float, yaw_sd_rad: float, *, delay_sd_s: float = DELAY_SD_S) -> PlaneFilter:
    """A bank at a fix, whose errors are the fix's: its slow one, and what the car drove in the unknown delay."""
    count = len(ERROR_MODELS)
    mean = np.zeros((count, STATES))
    mean[:, YAW] = yaw_rad
    covariance = np.zeros((count, STATES, STATES))
    for which, sd in ((YAW, yaw_sd_rad), (SCALE, SCALE_SD), (TURN, TURN_SD_RAD_PER_M), (DELAY, delay_sd_s)):
        covariance[:, which, which] = sd**2
    return moved_to(PlaneFilter(mean, covariance, np.full(count, 1 / count)), fix)


def moved_to(bank: PlaneFilter, fix: PlaceMeasurement) -> PlaneFilter:
    """The same heading, odometry and delay at a fix, as after a jump that turned out to be right."""
    mean, covariance = bank.mean.copy(), bank.covariance.copy()
    mean[:, :2], mean[:, SLOW] = fix.place_m, 0.0
    for lost, sd in ((EAST, ANYWHERE_SD_M), (NORTH, ANYWHERE_SD_M), (SLOW_EAST, 1.0), (SLOW_NORTH, 1.0)):
        covariance[:, lost, :] = covariance[:, :, lost] = 0.0
        covariance[:, lost, lost] = sd**2
    anywhere = replace(bank, mean=mean, covariance=covariance)
    return with_place(anywhere, expectation(anywhere, fix), 0.0)


def advanced(bank: PlaneFilter, step_m: Vector, turn_rad: float, elapsed_s: float) -> PlaneFilter:
    """The bank after a step (2,) in the axes of the car before it, and a turn counter-clockwise."""
    way_m = float(np.hypot(*step_m))
    cos, sin = np.cos(bank.mean[:, YAW]), np.sin(bank.mean[:, YAW])
    step = np.stack([cos * step_m[0] - sin * step_m[1], sin * step_m[0] + cos * step_m[1]], axis=1)
    scale = 1 + bank.mean[:, SCALE, None]
    kept = np.exp([-elapsed_s / model.memory_s for model in ERROR_MODELS])
    delay_kept = math.exp(-elapsed_s / DELAY_LASTS_S)
    mean = bank.mean.copy()
    mean[:, :2] += scale * step
    mean[:, YAW] += turn_rad + mean[:, TURN] * way_m
    mean[:, SLOW] *= kept[:, None]
    mean[:, DELAY] *= delay_kept
    jacobian = np.tile(np.eye(STATES), (len(mean), 1, 1))
    jacobian[:, :2, YAW] = scale * np.stack([-step[:, 1], step[:, 0]], axis=1)
    jacobian[:, :2, SCALE] = step
    jacobian[:, YAW, TURN] = way_m
    jacobian[:, SLOW_EAST, SLOW_EAST] = jacobian[:, SLOW_NORTH, SLOW_NORTH] = kept
    jacobian[:, DELAY, DELAY] = delay_kept
    covariance = jacobian @ bank.covariance @ jacobian.transpose(0, 2, 1)
    axes = np.arange(STATES)
    covariance[:, axes, axes] += _noise(way_m, turn_rad)
    covariance[:, DELAY, DELAY] += DELAY_SD_S**2 * (1 - delay_kept**2)
    covariance[:, SLOW_EAST, SLOW_EAST] += 1 - kept**2
    covariance[:, SLOW_NORTH, SLOW_NORTH] += 1 - kept**2
    return replace(bank, mean=mean, covariance=covariance)


def _noise(way_m: float, turn_rad: float) -> Vector:
    """Variances (8,) that a way adds; constants wander so that they are forgotten over `CONSTANTS_LAST_M`."""
    wander = 2 * way_m / CONSTANTS_LAST_M
    yaw = YAW_SD_RAD**2 * way_m + (YAW_SD_PER_TURN * turn_rad) ** 2
    place = WAY_SD_M**2 * way_m
    return np.array([place, place, yaw, SCALE_SD**2 * wander, TURN_SD_RAD_PER_M**2 * wander, 0.0, 0.0, 0.0])


@dataclass(frozen=True, slots=True)
class PlaceMeasurement:
    """A fix (2,) of a place (2,) in the axes of the car now: where the antenna was when it was measured.

    `behind_m` is the part of it that odometry carried since; `velocity_mps` (2,) in the same axes.
    """

    place_m: Vector
    sd_m: float
    antenna_m: Vector
    behind_m: Vector
    velocity_mps: Vector


@dataclass(frozen=True, slots=True)
class Expectation:
    """What each filter expects of a fix: (M, 2), its Jacobian (M, 2, 8), the fix's noise and the whole covariance, both
    (M, 2, 2)."""

    fix: PlaceMeasurement
    expected_m: Matrix
    jacobian: Matrix
    noise_m2: Matrix
    covariance_m2: Matrix


def innovation(bank: PlaneFilter, of: Expectation) -> tuple[Vector, Matrix]:
    """What the mixture did not foretell (2,), and its covariance (2, 2)."""
    mean = bank.weight @ of.expected_m
    apart = of.expected_m - mean
    spread = np.einsum("m,mi,mj->ij", bank.weight, apart, apart)
    covariance = np.einsum("m,mij->ij", bank.weight, of.covariance_m2) + spread
    return np.asarray(of.fix.place_m - mean), np.asarray(covariance)


def with_place(bank: PlaneFilter, of: Expectation, elapsed_s: float) -> PlaneFilter:
    """The bank after a fix, `elapsed_s` after the one before; models gain or lose weight by its likelihood."""
    residual = of.fix.place_m - of.expected_m
    inverse = np.linalg.inv(of.covariance_m2)
    gain = bank.covariance @ of.jacobian.transpose(0, 2, 1) @ inverse
    mean = bank.mean + np.einsum("mij,mj->mi", gain, residual)
    squared = np.einsum("mi,mij,mj->m", residual, inverse, residual)
    log_likelihood = -0.5 * (squared + np.log(np.linalg.det(of.covariance_m2)))
    log_weight = np.log(bank.weight) * math.exp(-elapsed_s / FORGET_S) + log_likelihood
    weight = np.maximum(np.exp(log_weight - log_weight.max()), LEAST_WEIGHT)
    covariance = _reduced(bank.covariance, gain, of.jacobian, of.noise_m2)
    return PlaneFilter(mean, covariance, weight / weight.sum())


def with_yaw(bank: PlaneFilter, yaw_rad: float, sd_rad: float) -> PlaneFilter:
    """The bank after a measured yaw, counter-clockwise from east."""
    residual = np.array([math.remainder(yaw_rad - yaw, 2 * math.pi) for yaw in bank.mean[:, YAW]])
    return _with_one(bank, YAW, residual, sd_rad)


def with_scale(bank: PlaneFilter, scale: float, sd: float) -> PlaneFilter:
    """The bank after a measurement of odometry's scale error."""
    return _with_one(bank, SCALE, scale - bank.mean[:, SCALE], sd)


def _with_one(bank: PlaneFilter, which: int, residual: Vector, sd: float) -> PlaneFilter:
    """The bank after a measurement of one of its numbers; the filters differ too little in it to be judged by it."""
    jacobian = np.zeros((len(bank.mean), 1, STATES))
    jacobian[:, 0, which] = 1.0
    noise = np.full((len(bank.mean), 1, 1), sd**2)
    gain = bank.covariance[:, :, which, None] / (bank.covariance[:, which, which] + sd**2)[:, None, None]
    mean = bank.mean + gain[:, :, 0] * residual[:, None]
    return replace(bank, mean=mean, covariance=_reduced(bank.covariance, gain, jacobian, noise))


def expectation(bank: PlaneFilter, fix: PlaceMeasurement) -> Expectation:
    """What the filters expect of a fix before they have seen it."""
    cos, sin = np.cos(bank.mean[:, YAW]), np.sin(bank.mean[:, YAW])
    enu_from_car = np.moveaxis(np.array([[cos, -sin], [sin, cos]]), 2, 0)
    behind = enu_from_car @ fix.behind_m
    velocity = enu_from_car @ fix.velocity_mps
    offset = enu_from_car @ fix.antenna_m - (1 + bank.mean[:, SCALE, None]) * behind
    offset -= bank.mean[:, DELAY, None] * velocity
    slow_m = fix.sd_m * np.array([model.slow for model in ERROR_MODELS])
    jacobian = np.zeros((len(bank.mean), 2, STATES))
    jacobian[:, 0, EAST] = jacobian[:, 1, NORTH] = 1.0
    jacobian[:, :, YAW] = np.stack([-offset[:, 1], offset[:, 0]], axis=1)
    jacobian[:, :, SCALE] = -behind
    jacobian[:, :, DELAY] = -velocity
    jacobian[:, 0, SLOW_EAST] = jacobian[:, 1, SLOW_NORTH] = slow_m
    late = STAMP_SD_S * velocity
    white_m2 = np.array([(fix.sd_m * model.white) ** 2 for model in ERROR_MODELS])
    noise = white_m2[:, None, None] * np.eye(2) + late[:, :, None] * late[:, None, :]
    return Expectation(
        fix,
        expected_m=bank.mean[:, :2] + offset + slow_m[:, None] * bank.mean[:, SLOW],
        jacobian=jacobian,
        noise_m2=noise,
        covariance_m2=jacobian @ bank.covariance @ jacobian.transpose(0, 2, 1) + noise,
    )


def _reduced(covariance: Matrix, gain: Matrix, jacobian: Matrix, noise: Matrix) -> Matrix:
    """Joseph's form, which stays symmetric and positive."""
    rest = np.eye(STATES) - gain @ jacobian
    return np.asarray(rest @ covariance @ rest.transpose(0, 2, 1) + gain @ noise @ gain.transpose(0, 2, 1))
