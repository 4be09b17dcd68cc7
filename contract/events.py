"""What crosses the WebSocket `/v1/events` (subprotocol `headsup.v1`), one JSON message a frame."""

from __future__ import annotations

from typing import Annotated, Literal
from uuid import UUID

from pydantic import Field, TypeAdapter

from contract.geometry import LatLon, Message
from contract.obstacle import ObstacleFeature

SUBPROTOCOL = "headsup.v1"
MIN_RADIUS_M = 50.0
MAX_RADIUS_M = 2_000.0


class Position(Message):
    """Vehicle to server: where I am; the server keeps an area of `radius_m` around the last one it acknowledged."""

    type: Literal["position"] = "position"
    position_seq: Annotated[int, Field(ge=1)]
    position: LatLon
    radius_m: Annotated[float, Field(ge=MIN_RADIUS_M, le=MAX_RADIUS_M)]


class Snapshot(Message):
    """Server to vehicle: everything in the area. Sent first, and whenever the vehicle fell behind."""

    type: Literal["snapshot"] = "snapshot"
    position_seq: int
    obstacles: tuple[ObstacleFeature, ...]


class Moved(Message):
    """Server to vehicle: position acknowledged; what came into and left the area was sent before this."""

    type: Literal["moved"] = "moved"
    position_seq: int


class Appeared(Message):
    """Server to vehicle: an obstacle is new, or has come into the area."""

    type: Literal["appeared"] = "appeared"
    position_seq: int
    obstacle: ObstacleFeature


class Updated(Message):
    """Server to vehicle: a served field changed. Latest wins: apply only a higher revision."""

    type: Literal["updated"] = "updated"
    position_seq: int
    obstacle: ObstacleFeature


class Removed(Message):
    """Server to vehicle: the obstacle is gone (filled, merged into another, expired)."""

    type: Literal["removed"] = "removed"
    position_seq: int
    obstacle_id: UUID
    revision: int
    reason: Literal["absent", "merged", "expired", "operator"]
    merged_into: UUID | None = None


class Left(Message):
    """Server to vehicle: the obstacle exists but lies outside the area now (beyond 1.2 radii)."""

    type: Literal["left"] = "left"
    position_seq: int
    obstacle_id: UUID


ServerMessage = Snapshot | Moved | Appeared | Updated | Removed | Left

server_message: TypeAdapter[ServerMessage] = TypeAdapter(Annotated[ServerMessage, Field(discriminator="type")])
"""Parser of what a vehicle receives."""
