"""Where an obstacle is, from one measurement and from many: fusion by inverse covariance (information filter)."""

from __future__ import annotations

import numpy as np

from contract.observation import Detection, Origin
from server.geodesy import covariance_of, east_north_m, matrix_m2, offset_from
from server.matching import centre_m, stored_covariance_m2
from server.obstacle import Place
from server.policy import Matching

# A report that claims a perfect position weighs like one known to a centimetre.
_LEAST_SD_M = 0.01


def measured_place(origin: Origin, detection: Detection) -> Place:
    """Place of a detection, with the pose error of its report."""
    return Place(
        position=offset_from(origin.position, centre_m(detection)),
        covariance=covariance_of(matrix_m2(origin.covariance) + matrix_m2(detection.covariance)),
        altitude_m=origin.altitude_m + detection.up_m,
        altitude_sd_m=origin.altitude_sd_m,
    )


def fused_place(stored: Place, origin: Origin, detection: Detection, policy: Matching) -> Place:
    """A stored place and a measurement, weighed by their inverse covariances."""
    measured = measured_place(origin, detection)
    stored_m2 = stored_covariance_m2(stored, policy)
    measured_m2 = matrix_m2(measured.covariance) + _LEAST_SD_M**2 * np.eye(2)
    gain = stored_m2 @ np.linalg.inv(stored_m2 + measured_m2)
    stored_offset_m = east_north_m(stored.position, origin.position)
    offset_m = stored_offset_m + gain @ (centre_m(detection) - stored_offset_m)
    altitude_m, altitude_sd_m = _fused_altitude(stored, measured)
    fused = Place(
        position=offset_from(origin.position, offset_m),
        covariance=covariance_of(stored_m2 - gain @ stored_m2),
        altitude_m=altitude_m,
        altitude_sd_m=altitude_sd_m,
    )
    return Place(fused.position, covariance_of(stored_covariance_m2(fused, policy)), altitude_m, altitude_sd_m)


def _fused_altitude(a: Place, b: Place) -> tuple[float, float]:
    a_weight, b_weight = (1 / max(place.altitude_sd_m, _LEAST_SD_M) ** 2 for place in (a, b))
    total = a_weight + b_weight
    return (a_weight * a.altitude_m + b_weight * b.altitude_m) / total, float(total**-0.5)
