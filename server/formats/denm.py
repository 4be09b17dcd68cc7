"""DENM as JSON: names and integer units of the ASN.1 of its release 1 (ETSI EN 302 637-3), enumerations as numbers.

Release 2 (TS 103 831) calls several fields otherwise, and wants the way to the event (its location container).
"""

from __future__ import annotations

import hashlib
import math
from datetime import datetime
from typing import Any
from uuid import UUID

from contract.geometry import PlaneCovariance
from contract.observation import State
from contract.obstacle import ObstacleFeature, ObstacleProperties
from server.formats.codes import denm_cause
from server.geometry.uncertainty import error_ellipse

_ITS_EPOCH_UNIX_MS = 1_072_915_200_000
_GREATEST_ITS_MS = 4_398_046_511_103
_GREATEST_VALIDITY_S = 86_400
# TS 102 894-2 gives ellipses at 95 %: sqrt of the chi-square quantile with 2 degrees of freedom.
_SIGMAS_OF_95_PERCENT = 2.447746830680816
_AXIS_OUT_OF_RANGE_CM = 4_094
_ALTITUDE_LOWEST, _ALTITUDE_HIGHEST = -100_000, 800_000
_ALTITUDE_CONFIDENCE_UNAVAILABLE = 15
_ROAD_SIDE_UNIT = 15
_PROTOCOL_VERSION, _MESSAGE_ID = 2, 1
# A driver at 130 km/h wants ten seconds: `lessThan500m`.
_RELEVANCE_DISTANCE = 3
_ALL_TRAFFIC_DIRECTIONS = 0
_IS_NEGATION = 1


def message(feature: ObstacleFeature) -> dict[str, Any]:
    """An obstacle as a DENM; one that was removed as its negation. The same obstacle always has the same actionID."""
    station, number = action_id(feature.id)
    return {
        "header": {"protocolVersion": _PROTOCOL_VERSION, "messageID": _MESSAGE_ID, "stationID": station},
        "denm": {
            "management": _management(feature, {"originatingStationID": station, "sequenceNumber": number}),
            "situation": _situation(feature.properties),
        },
    }


def action_id(identifier: UUID) -> tuple[int, int]:
    """`originatingStationID` (32 bits) and `sequenceNumber` (16 bits) of an obstacle.

    A sequence number alone tells 65,536 obstacles apart, so both follow from the id.
    """
    digest = hashlib.sha256(identifier.bytes).digest()
    return int.from_bytes(digest[:4]), int.from_bytes(digest[4:6])


def its_ms(moment: datetime) -> int:
    """`TimestampIts`: milliseconds since 2004-01-01T00:00:00Z, within the type's range."""
    return max(0, min(_GREATEST_ITS_MS, int(moment.timestamp() * 1000) - _ITS_EPOCH_UNIX_MS))


def ellipse(covariance: PlaneCovariance) -> dict[str, int]:
    """`positionConfidenceEllipse`: semi-axes at 95 % in cm, major axis in 0.1 degree clockwise from north."""
    major_sd_m, minor_sd_m, azimuth_rad = error_ellipse(covariance)
    return {
        "semiMajorConfidence": _axis_cm(major_sd_m),
        "semiMinorConfidence": _axis_cm(minor_sd_m),
        "semiMajorOrientation": round(10 * math.degrees(azimuth_rad)) % 1800,
    }


def _management(feature: ObstacleFeature, action: dict[str, int]) -> dict[str, Any]:
    properties = feature.properties
    management = {
        "actionID": action,
        "detectionTime": its_ms(properties.last_seen),
        "referenceTime": reference_time(properties),
    }
    if properties.state is State.REMOVED:
        management["termination"] = _IS_NEGATION
    return management | {
        "eventPosition": _position(feature),
        "relevanceDistance": _RELEVANCE_DISTANCE,
        "relevanceTrafficDirection": _ALL_TRAFFIC_DIRECTIONS,
        "validityDuration": _validity_s(properties),
        "stationType": _ROAD_SIDE_UNIT,
    }


def reference_time(properties: ObstacleProperties) -> int:
    """`referenceTime`: later with every revision, as an update needs, though a late report moves no moment of ours."""
    return min(_GREATEST_ITS_MS, its_ms(properties.as_of) + properties.revision)


def _position(feature: ObstacleFeature) -> dict[str, Any]:
    position, properties = feature.position, feature.properties
    altitude_cm = round(100 * properties.altitude_m)
    return {
        "latitude": round(1e7 * position.latitude_deg),
        "longitude": round(1e7 * position.longitude_deg),
        "positionConfidenceEllipse": ellipse(properties.position_covariance),
        "altitude": {
            "altitudeValue": max(_ALTITUDE_LOWEST, min(_ALTITUDE_HIGHEST, altitude_cm)),
            "altitudeConfidence": _ALTITUDE_CONFIDENCE_UNAVAILABLE,
        },
    }


def _situation(properties: ObstacleProperties) -> dict[str, Any]:
    code = denm_cause(properties)
    return {
        # 0 means unavailable, 1 the lowest, 7 the highest.
        "informationQuality": max(1, min(7, math.ceil(7 * properties.confidence))),
        "eventType": {"causeCode": code.cause, "subCauseCode": code.sub_cause},
    }


def _validity_s(properties: ObstacleProperties) -> int:
    lasts_s = (properties.expires_at - properties.last_seen).total_seconds()
    return max(0, min(_GREATEST_VALIDITY_S, int(lasts_s)))


def _axis_cm(sd_m: float) -> int:
    return max(1, min(_AXIS_OUT_OF_RANGE_CM, math.ceil(100 * _SIGMAS_OF_95_PERCENT * sd_m)))
