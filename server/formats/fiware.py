"""FIWARE: the smart data model Alert as NGSI-LD entities (ETSI GS CIM 009), normalised."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from contract.observation import State
from contract.obstacle import ObstacleFeature
from server.formats.codes import CODES, sentence

CONTEXT = (
    "https://smartdatamodels.org/context.jsonld",
    "https://uri.etsi.org/ngsi-ld/v1/ngsi-ld-core-context.jsonld",
)


def entity(feature: ObstacleFeature) -> dict[str, Any]:
    """An obstacle as an Alert; one that was removed has the status `solved`."""
    properties = feature.properties
    is_solved = properties.state is State.REMOVED
    return {
        "id": f"urn:ngsi-ld:Alert:{feature.id}",
        "type": "Alert",
        "category": _property("traffic"),
        "subCategory": _property(CODES[properties.kind].fiware),
        "description": _property(sentence(properties)),
        "status": _property("solved" if is_solved else "active"),
        "dateIssued": _property(_moment(properties.first_seen)),
        "dateModified": _property(_moment(properties.as_of)),
        "validFrom": _property(_moment(properties.first_seen)),
        "validTo": _property(_moment(properties.as_of if is_solved else properties.expires_at)),
        "location": {
            "type": "GeoProperty",
            "value": {"type": "Point", "coordinates": list(feature.geometry.coordinates)},
        },
        "confidence": _property(round(properties.confidence, 3)),
        "@context": list(CONTEXT),
    }


def _property(value: object) -> dict[str, Any]:
    return {"type": "Property", "value": value}


def _moment(moment: datetime) -> dict[str, str]:
    return {"@type": "DateTime", "@value": moment.astimezone(UTC).isoformat().replace("+00:00", "Z")}
