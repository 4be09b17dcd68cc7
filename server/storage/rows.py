"""Between obstacles and rows of the table `obstacle`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any
from uuid import UUID

from pydantic import TypeAdapter
from sqlalchemy import RowMapping

from contract.geometry import Kind, LatLon, PlaneCovariance
from contract.observation import State
from contract.obstacle import InspectionState
from server.geometry.quadkey import cell_of
from server.life.decay import expires_at
from server.life.obstacle import Obstacle, Place, Shape, Size, Witness
from server.life.policy import Life

Row = RowMapping | Mapping[str, Any]
"""Values by the names of columns, as SQLAlchemy has them, or a plain mapping."""


@dataclass(frozen=True, slots=True)
class Sizes:
    """What is remembered of sizes besides the served one."""

    references: tuple[Size, ...]
    pending: Size | None


_shape = TypeAdapter(Shape)
_sizes = TypeAdapter(Sizes)
_votes = TypeAdapter(dict[Kind, int])
_moments = TypeAdapter(tuple[datetime, ...])
_ids = TypeAdapter(list[UUID])


def row_of(obstacle: Obstacle, life: Life) -> dict[str, Any]:
    """Values of the table `obstacle`."""
    place = obstacle.place
    return {
        "shard": obstacle.shard,
        "id": obstacle.id,
        "cell": cell_of(place.position),
        "kind": obstacle.kind.value,
        "kind_votes": _votes.dump_json(obstacle.kind_votes).decode(),
        "state": obstacle.state.value,
        "version": obstacle.version,
        "revision": obstacle.revision,
        "latitude_deg": place.position.latitude_deg,
        "longitude_deg": place.position.longitude_deg,
        "born_latitude_deg": obstacle.born_at.latitude_deg,
        "born_longitude_deg": obstacle.born_at.longitude_deg,
        "east_m2": place.covariance.east_m2,
        "north_m2": place.covariance.north_m2,
        "east_north_m2": place.covariance.east_north_m2,
        "altitude_m": place.altitude_m,
        "altitude_sd_m": place.altitude_sd_m,
        "shape": _shape.dump_json(obstacle.shape).decode(),
        "sizes": _sizes.dump_json(Sizes(obstacle.references, obstacle.pending)).decode(),
        "confidence": obstacle.confidence,
        "as_of": obstacle.as_of,
        "expires_at": expires_at(obstacle, life),
        "first_seen": obstacle.first_seen,
        "last_seen": obstacle.last_seen,
        "sightings": obstacle.sightings,
        "witness_count": obstacle.witness_count,
        "absent_since": obstacle.absent_since,
        "succeeds": obstacle.succeeds,
        "merged_into": obstacle.merged_into,
        "removed_at": obstacle.removed_at,
        "removed_reason": obstacle.removed_reason,
        "inspection_state": obstacle.inspection_state.value,
        "distinct_from": _ids.dump_json(sorted(obstacle.distinct_from)).decode(),
    }


def obstacle_of(row: Row, evidence: Sequence[Witness] = ()) -> Obstacle:
    """An obstacle from its row and the evidence loaded for it."""
    sizes = _sizes.validate_json(row["sizes"])
    return Obstacle(
        id=row["id"],
        shard=row["shard"],
        kind=Kind(row["kind"]),
        kind_votes=_votes.validate_json(row["kind_votes"]),
        state=State(row["state"]),
        version=row["version"],
        revision=row["revision"],
        born_at=LatLon(latitude_deg=row["born_latitude_deg"], longitude_deg=row["born_longitude_deg"]),
        place=Place(
            position=position_of(row),
            covariance=PlaneCovariance(
                east_m2=row["east_m2"], north_m2=row["north_m2"], east_north_m2=row["east_north_m2"]
            ),
            altitude_m=row["altitude_m"],
            altitude_sd_m=row["altitude_sd_m"],
        ),
        shape=_shape.validate_json(row["shape"]),
        references=sizes.references,
        pending=sizes.pending,
        confidence=row["confidence"],
        as_of=row["as_of"],
        first_seen=row["first_seen"],
        last_seen=row["last_seen"],
        sightings=row["sightings"],
        witness_count=row["witness_count"],
        evidence=tuple(evidence),
        absent_since=row["absent_since"],
        succeeds=row["succeeds"],
        merged_into=row["merged_into"],
        removed_at=row["removed_at"],
        removed_reason=row["removed_reason"],
        inspection_state=InspectionState(row["inspection_state"]),
        distinct_from=frozenset(_ids.validate_json(row["distinct_from"])),
    )


def position_of(row: Row) -> LatLon:
    """Where a row says that something is."""
    return LatLon(latitude_deg=row["latitude_deg"], longitude_deg=row["longitude_deg"])


def shape_json(shape: Shape) -> Any:
    """A shape for the history of versions."""
    return _shape.dump_python(shape, mode="json")


def witness_row(shard: int, obstacle_id: UUID, witness: Witness) -> dict[str, Any]:
    """Values of the table `witness`."""
    moments = [moment for moment in (witness.last_seen_at, witness.absent_at) if moment is not None]
    return {
        "shard": shard,
        "obstacle_id": obstacle_id,
        "name": witness.name,
        "seen_at": _moments.dump_json(witness.seen_at).decode(),
        "absent_at": witness.absent_at,
        "latest_at": max(moments),
    }


def witness_of(row: Row) -> Witness:
    """A witness's evidence from its row."""
    return Witness(row["name"], _moments.validate_json(row["seen_at"]), row["absent_at"])
