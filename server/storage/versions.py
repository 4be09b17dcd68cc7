"""Versions of an obstacle's shape that were replaced, and the points of one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from uuid import UUID

import numpy as np
import pymap3d
from pydantic import TypeAdapter
from sqlalchemy import select
from sqlalchemy.ext.asyncio import AsyncConnection

from contract.obstacle import MultiPointGeometry, ObstaclePoints, PointsProperties
from server.life.identity import shard_of_id
from server.life.obstacle import Obstacle, Place, Points, Shape
from server.storage import tables

_shape = TypeAdapter(Shape)


@dataclass(frozen=True, slots=True)
class Version:
    """A shape that an obstacle had, and when another replaced it (None: it has it still)."""

    number: int
    shape: Shape
    replaced_at: datetime | None


async def stored_versions(connection: AsyncConnection, identifier: UUID) -> tuple[Version, ...]:
    """Replaced versions of an obstacle, oldest first."""
    table = tables.obstacle_version
    query = (
        select(table)
        .where(table.c.shard == shard_of_id(identifier), table.c.obstacle_id == identifier)
        .order_by(table.c.version)
    )
    found = (await connection.execute(query)).mappings()
    return tuple(Version(row["version"], _shape.validate_python(row["shape"]), row["replaced_at"]) for row in found)


async def all_versions(connection: AsyncConnection, obstacle: Obstacle) -> Sequence[Version]:
    """Every version of an obstacle, oldest first, the current one last."""
    return [*await stored_versions(connection, obstacle.id), Version(obstacle.version, obstacle.shape, None)]


def points_of(obstacle: Obstacle, version: Version) -> ObstaclePoints:
    """The points of a version about the obstacle's present place.

    Where the place was thought to be when that version was current is not kept; it has only become more precise.
    """
    return ObstaclePoints(
        id=obstacle.id,
        geometry=MultiPointGeometry(coordinates=_wgs84(version.shape.points_cm, obstacle.place)),
        properties=PointsProperties(kind=obstacle.kind, version=version.number, observed_at=version.shape.observed_at),
    )


def _wgs84(points_cm: Points, place: Place) -> tuple[tuple[float, float, float], ...]:
    """Longitude, latitude in degrees and ellipsoidal height in metres of offsets east, north, up of a place."""
    east_m, north_m, up_m = (np.array(points_cm, dtype=np.float64).reshape(-1, 3) / 100).T
    centre = place.position
    latitudes_deg, longitudes_deg, heights_m = pymap3d.enu2geodetic(
        east_m, north_m, up_m, centre.latitude_deg, centre.longitude_deg, place.altitude_m
    )
    wrapped_deg = (longitudes_deg + 180.0) % 360.0 - 180.0
    # 1e-8 degrees are a millimetre, a tenth of what a point's own resolution is.
    return tuple(
        zip(
            np.round(wrapped_deg, 8).tolist(),
            np.round(latitudes_deg, 8).tolist(),
            np.round(heights_m, 3).tolist(),
            strict=True,
        )
    )
