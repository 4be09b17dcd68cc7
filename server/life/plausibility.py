"""What is not believed: detections outside the policy's limits, and reports whose time or place cannot be right."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime, timedelta

from contract.geometry import LatLon
from contract.observation import Detection, ObservationReport
from server.geometry.geodesy import is_within
from server.geometry.symmetric import greatest_sd_m
from server.life.policy import Plausibility, Times


@dataclass(frozen=True, slots=True)
class LastPlace:
    """Where a witness was when it last reported."""

    position: LatLon
    sd_m: float
    observed_at: datetime


def place_of(report: ObservationReport, observed_at: datetime) -> LastPlace:
    """Where a report says the vehicle was, at its corrected time."""
    return LastPlace(report.origin.position, greatest_sd_m(report.origin.covariance), observed_at)


def is_too_fast(before: LastPlace, now: LastPlace, limits: Plausibility) -> bool:
    """Whether no vehicle can have been at both places, at either order of times; never with an infinite limit."""
    seconds = abs((now.observed_at - before.observed_at).total_seconds())
    if seconds > limits.speed_window_s or math.isinf(limits.greatest_speed_mps):
        return False
    errors_m = 3 * math.hypot(before.sd_m, now.sd_m) + limits.speed_slack_m
    return not is_within(before.position, now.position, errors_m + limits.greatest_speed_mps * seconds)


def report_rejection(report: ObservationReport, age: timedelta, limits: Plausibility, times: Times) -> str | None:
    """Why a whole report is rejected, or None. `age` is that of the observation, corrected for the vehicle's clock."""
    if age < -times.future:
        return "in-the-future"
    if age > times.oldest:
        return "too-old"
    if abs(report.origin.position.latitude_deg) > limits.greatest_latitude_deg:
        return "beyond-the-map"
    if greatest_sd_m(report.origin.covariance) > limits.greatest_pose_sd_m:
        return "pose-too-uncertain"
    return None


def detection_rejection(detection: Detection, limits: Plausibility) -> str | None:
    """Why a detection is rejected, or None."""
    box = detection.box
    if not limits.least_side_mm <= box.width_mm <= box.length_mm <= limits.greatest_side_mm:
        return "size"
    if not limits.least_relief_mm <= box.relief_mm <= limits.greatest_relief_mm:
        return "relief"
    if detection.confidence < limits.least_confidence:
        return "confidence"
    if detection.view.hits < limits.least_hits:
        return "too-few-points"
    if math.hypot(detection.east_m, detection.north_m) > limits.reach_m or abs(detection.up_m) > limits.greatest_up_m:
        return "out-of-reach"
    if greatest_sd_m(detection.covariance) > limits.greatest_centre_sd_m:
        return "position-too-uncertain"
    return None


def clock_correction(sent_at: datetime, received_at: datetime, times: Times) -> timedelta | None:
    """What to add to the vehicle's times: nothing for a small skew, None when its clock is too wrong to correct."""
    skew = received_at - sent_at
    if abs(skew) > times.corrected_skew:
        return None
    return skew if abs(skew) > times.tolerated_skew else timedelta()
