"""A partner feed like Waze's CIFS (Closure and Incident Feed Specification): what is gone leaves the feed."""

from __future__ import annotations

import math
from collections.abc import Iterable
from datetime import datetime
from typing import Any

from contract.geometry import LatLon
from contract.observation import State
from contract.obstacle import ObstacleFeature
from server.formats.codes import CODES, sentence
from server.geometry.geodesy import offset_from


def feed(features: Iterable[ObstacleFeature]) -> dict[str, Any]:
    """The live ones of the obstacles as incidents."""
    return {"incidents": [_incident(item) for item in features if item.properties.state is not State.REMOVED]}


def _incident(feature: ObstacleFeature) -> dict[str, Any]:
    properties = feature.properties
    return {
        "id": str(feature.id),
        "type": "HAZARD",
        "subtype": CODES[properties.kind].waze,
        "polyline": " ".join(f"{end.latitude_deg:.7f} {end.longitude_deg:.7f}" for end in _ends(feature)),
        "direction": "BOTH_DIRECTIONS",
        "description": sentence(properties),
        "creationtime": _moment(properties.first_seen),
        "updatetime": _moment(properties.as_of),
        "starttime": _moment(properties.first_seen),
        "endtime": _moment(properties.expires_at),
    }


def _ends(feature: ObstacleFeature) -> tuple[LatLon, LatLon]:
    """The two ends of the box's length: the feed knows lines only."""
    box = feature.properties.box
    half_m = box.length_mm / 2000
    east_m, north_m = half_m * math.cos(box.yaw_rad), half_m * math.sin(box.yaw_rad)
    return offset_from(feature.position, -east_m, -north_m), offset_from(feature.position, east_m, north_m)


def _moment(moment: datetime) -> str:
    return moment.isoformat(timespec="seconds")
