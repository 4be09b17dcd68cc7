"""Obstacles as flat features. Pure."""

from __future__ import annotations

import math

from contract.obstacle import ObstacleFeature
from server.geometry.uncertainty import error_ellipse
from server.ogc.models import FlatProperties, Item


def item(feature: ObstacleFeature) -> Item:
    """An obstacle as a row of a GIS table."""
    known = feature.properties
    properties = FlatProperties(
        kind=known.kind,
        sign=known.sign,
        state=known.state,
        length_m=known.box.length_mm / 1000,
        width_m=known.box.width_mm / 1000,
        relief_m=known.box.relief_mm / 1000,
        yaw_deg=round(math.degrees(known.box.yaw_rad), 3),
        volume_m3=known.volume_m3,
        altitude_m=known.altitude_m,
        position_sd_m=round(error_ellipse(known.position_covariance).major_sd_m, 3),
        confidence=known.confidence,
        as_of=known.as_of,
        half_life_s=known.half_life_s,
        expires_at=known.expires_at,
        first_seen=known.first_seen,
        last_seen=known.last_seen,
        sightings=known.sightings,
        witnesses=known.witnesses,
        version=known.version,
        revision=known.revision,
        inspection_state=known.inspection_state,
    )
    return Item(id=feature.id, geometry=feature.geometry, properties=properties)
