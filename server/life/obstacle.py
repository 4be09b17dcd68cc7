"""An obstacle as it is stored: immutable values, and nothing of how they are stored."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Literal, NamedTuple
from uuid import UUID

from contract.geometry import Box, BoxSd, Kind, LatLon, PlaneCovariance, Sign
from contract.observation import Descriptor, State
from contract.obstacle import InspectionState

Points = tuple[tuple[int, int, int], ...]
RemovalReason = Literal["absent", "merged", "expired", "operator"]


@dataclass(frozen=True, slots=True)
class Place:
    """Where an obstacle's centre is: WGS 84, covariance of (east, north) in square metres."""

    position: LatLon
    covariance: PlaneCovariance
    altitude_m: float
    altitude_sd_m: float

    @property
    def variances_m2(self) -> float:
        """Sum of the variances along east and north."""
        return self.covariance.east_m2 + self.covariance.north_m2


@dataclass(frozen=True, slots=True)
class Shape:
    """What is served and drawn of the current version."""

    box: Box
    box_sd: BoxSd
    volume_m3: float
    descriptor: Descriptor
    points_cm: Points
    observed_at: datetime


@dataclass(frozen=True, slots=True)
class Size:
    """A size seen from one kind of view, and the number of passes it is the mean of."""

    view: str
    box: Box
    sd: BoxSd
    passes: int = 1


@dataclass(frozen=True, slots=True)
class Witness:
    """Evidence of one witness about one obstacle: its latest passes with a sighting, in order, and its last absence."""

    name: str
    seen_at: tuple[datetime, ...] = ()
    absent_at: datetime | None = None

    @property
    def last_seen_at(self) -> datetime | None:
        """The latest sighting."""
        return self.seen_at[-1] if self.seen_at else None


class Obstacle(NamedTuple):
    """One obstacle. `version` counts shapes, `revision` every change of a served field.

    A named tuple, since a report makes some seven of them, and a dataclass of so many fields takes ten times as long.

    `witness_count` counts all who saw it; `evidence` holds the records that a decision may need: that of the reporting
    witness, and all since `absent_since`, the first open absence. `distinct_from` are obstacles that one vehicle
    saw beside this one.
    """

    id: UUID
    shard: int
    kind: Kind
    kind_votes: dict[Kind, int]
    state: State
    version: int
    revision: int
    born_at: LatLon
    place: Place
    shape: Shape
    references: tuple[Size, ...]
    pending: Size | None
    confidence: float
    as_of: datetime
    first_seen: datetime
    last_seen: datetime
    sightings: int
    witness_count: int
    evidence: tuple[Witness, ...]
    absent_since: datetime | None = None
    succeeds: UUID | None = None
    merged_into: UUID | None = None
    removed_at: datetime | None = None
    removed_reason: RemovalReason | None = None
    inspection_state: InspectionState = InspectionState.OPEN
    distinct_from: frozenset[UUID] = frozenset()

    @property
    def sign(self) -> Sign:
        """Below or above the road."""
        return self.kind.sign

    @property
    def closed_until(self) -> datetime | None:
        """What was seen up to here says nothing new of a removed obstacle; None when it is live, or part of another."""
        if self.is_live or self.merged_into is not None:
            return None
        return self.as_of if self.removed_reason == "expired" else self.removed_at

    @property
    def is_live(self) -> bool:
        """Whether it has not been removed."""
        return self.state is not State.REMOVED
