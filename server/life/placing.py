"""Where an obstacle is, from one measurement and from many: fusion by inverse covariance (information filter)."""

from __future__ import annotations

from contract.observation import Detection, Origin
from server.geometry.geodesy import east_north_m, offset_from
from server.geometry.symmetric import Symmetric, covariance_of, matrix_m2
from server.life.matching import stored_covariance_m2
from server.life.obstacle import Place
from server.life.policy import Matching

# A report that claims a perfect position weighs like one known to a centimetre.
_LEAST_SD_M = 0.01


def measured_place(origin: Origin, detection: Detection) -> Place:
    """Place of a detection, with the pose error of its report."""
    return Place(
        position=offset_from(origin.position, detection.east_m, detection.north_m),
        covariance=covariance_of(_measured_m2(origin, detection)),
        altitude_m=origin.altitude_m + detection.up_m + 0.0,
        altitude_sd_m=origin.altitude_sd_m + 0.0,
    )


def fused_place(stored: Place, origin: Origin, detection: Detection, policy: Matching) -> Place:
    """A stored place and a measurement, weighed by their inverse covariances."""
    stored_information = stored_covariance_m2(stored, policy).inverse()
    information = _measured_m2(origin, detection).widened(_LEAST_SD_M**2).inverse()
    fused_m2 = stored_information.plus(information).inverse()
    known = east_north_m(stored.position, origin.position)
    pulled = information.times(detection.east_m - known.east_m, detection.north_m - known.north_m)
    gain_east_m, gain_north_m = fused_m2.times(*pulled)
    altitude_m, altitude_sd_m = _fused_altitude(stored, origin.altitude_m + detection.up_m, origin.altitude_sd_m)
    return Place(
        position=offset_from(origin.position, known.east_m + gain_east_m, known.north_m + gain_north_m),
        covariance=covariance_of(fused_m2.floored(policy.least_stored_sd_m**2)),
        altitude_m=altitude_m,
        altitude_sd_m=altitude_sd_m,
    )


def _measured_m2(origin: Origin, detection: Detection) -> Symmetric:
    return matrix_m2(origin.covariance).plus(matrix_m2(detection.covariance))


def _fused_altitude(stored: Place, altitude_m: float, sd_m: float) -> tuple[float, float]:
    stored_weight, weight = (1 / max(sd, _LEAST_SD_M) ** 2 for sd in (stored.altitude_sd_m, sd_m))
    total = stored_weight + weight
    return (stored_weight * stored.altitude_m + weight * altitude_m) / total, float(total**-0.5)
