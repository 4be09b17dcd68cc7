"""What an operator does to an obstacle, and what became of an obstacle over time."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Literal
from uuid import UUID

from pydantic import Field

from contract.geometry import Box, BoxSd, Message, UtcDatetime
from contract.observation import State
from contract.obstacle import InspectionState, Link, ObstacleFeature, RemovalReason

Note = Annotated[str, Field(max_length=500, description="for the audit log")]


class Confirm(Message):
    """Somebody has seen it: `confirmed`, whatever the number of witnesses; an open inspection becomes `inspected`."""

    action: Literal["confirm"]
    note: Note = ""


class Dismiss(Message):
    """It is no obstacle: removed, inspection state `not_an_issue`."""

    action: Literal["dismiss"]
    note: Note = ""


class Repaired(Message):
    """It has been repaired or cleared: removed, inspection state `repaired`."""

    action: Literal["repaired"]
    note: Note = ""


class Inspect(Message):
    """Note where the obstacle stands in the operator's work; nothing else changes."""

    action: Literal["inspection_state"]
    inspection_state: InspectionState
    note: Note = ""


OperatorAction = Annotated[Confirm | Dismiss | Repaired | Inspect, Field(discriminator="action")]
"""Body of `POST /v1/obstacles/{id}/actions`."""


class ActionKind(StrEnum):
    """What was done to an obstacle without a report."""

    CONFIRM = "confirm"
    DISMISS = "dismiss"
    REPAIRED = "repaired"
    INSPECTION_STATE = "inspection_state"
    DELETE = "delete"
    EXPIRE = "expire"


class Standing(Message):
    """What an operator's action may change of an obstacle."""

    state: State
    inspection_state: InspectionState
    revision: int


class ActionRecord(Message):
    """A line of the audit log. `key_id` is the id of the operator's API key, never the key."""

    id: UUID
    at: UtcDatetime
    key_id: str
    action: str
    obstacle_id: UUID
    note: str
    before: Standing | None
    after: Standing | None
    request_id: str | None


class ActionLog(Message):
    """A page of the audit log, oldest first."""

    actions: tuple[ActionRecord, ...]
    links: tuple[Link, ...] = ()


class HistoryEvent(Message):
    """A served field changed; `obstacle` is how it was served from then on."""

    type: Literal["event"] = "event"
    at: UtcDatetime
    what: Literal["created", "updated", "removed"]
    reason: RemovalReason | None = None
    obstacle: ObstacleFeature


class HistoryVersion(Message):
    """A shape of the obstacle, measured at `at`; `until` is when another replaced it."""

    type: Literal["version"] = "version"
    at: UtcDatetime
    version: int
    box: Box
    box_sd: BoxSd
    volume_m3: float
    points: Annotated[int, Field(ge=0, description="number of points kept of it")]
    until: UtcDatetime | None = None


class HistoryAction(Message):
    """An operator's action; who did it is told to operators only (`GET /v1/actions`)."""

    type: Literal["action"] = "action"
    at: UtcDatetime
    action: str
    before: Standing | None
    after: Standing | None


HistoryEntry = Annotated[HistoryEvent | HistoryVersion | HistoryAction, Field(discriminator="type")]


class ObstacleHistory(Message):
    """A page of what became of an obstacle, oldest first."""

    obstacle_id: UUID
    entries: tuple[HistoryEntry, ...]
    links: tuple[Link, ...] = ()
