"""ITIS codes (SAE J2540-2), as roadside and traveller information systems list them."""

from __future__ import annotations

from typing import Any

from contract.observation import State
from contract.obstacle import ObstacleFeature
from server.formats.codes import CODES, ITIS_CLEARED, sentence


def item(feature: ObstacleFeature) -> dict[str, Any]:
    """An obstacle with its codes; one that was removed ends with `cleared`."""
    properties, position = feature.properties, feature.position
    codes = [CODES[properties.kind].itis]
    if properties.state is State.REMOVED:
        codes.append(ITIS_CLEARED)
    return {
        "id": str(feature.id),
        "itis": codes,
        "text": sentence(properties),
        "latitude": round(position.latitude_deg, 7),
        "longitude": round(position.longitude_deg, 7),
        "elevation_m": round(properties.altitude_m, 1),
        "updated": properties.as_of.isoformat(),
        "expires": properties.expires_at.isoformat(),
    }
