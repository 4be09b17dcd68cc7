"""What one write transaction sees and changes: rows read once, decided upon in memory, written in bulk at the end.

Many reports share a transaction (group commit). Each is decided on the state that those before it left, exactly as if
each had its own transaction, and what a later report changes again is written once.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime
from operator import attrgetter
from typing import Literal
from uuid import UUID

from contract.obstacle import InspectionState
from server.geometry.cell_index import CellIndex
from server.geometry.quadkey import cell_of, tile_of_cell
from server.life.obstacle import Obstacle, Witness
from server.life.policy import Life
from server.life.reach import Reach
from server.storage.features import ObstacleEvent, event_of, feature_text

Evidence = dict[tuple[UUID, str], Witness]
Outcome = Literal["shared", "refuted"]
"""What became of something that one witness alone had reported: seen by another, or found not to be there."""


@dataclass(slots=True)
class Tile:
    """A locked row of the table `tile`: `version` numbers its events, `lock_seq` what was decided there."""

    version: int
    lock_seq: int


@dataclass(frozen=True, slots=True)
class EventLine:
    """A line of the table `event`."""

    tile: int
    seq: int
    obstacle_id: UUID
    body: str
    written_at: datetime


@dataclass(frozen=True, slots=True)
class Ended:
    """An obstacle in a version that another replaced."""

    obstacle: Obstacle
    replaced_at: datetime


@dataclass(frozen=True, slots=True)
class Creation:
    """Who reported an obstacle first."""

    obstacle_id: UUID
    witness: str
    created_at: datetime


class WorkingSet:
    """Obstacles as they stand within a transaction that holds `tiles`; `evidence` is what was read with them."""

    def __init__(self, tiles: dict[int, Tile], obstacles: Iterable[Obstacle], evidence: Evidence, life: Life) -> None:
        self._life = life
        self.tiles = tiles
        self.stored_evidence = frozenset(evidence)
        self._current: dict[UUID, Obstacle] = {}
        self._current.update((obstacle.id, obstacle) for obstacle in obstacles)
        self._cells = {item.id: cell_of(item.place.position) for item in self._current.values()}
        self._index = CellIndex((cell, identifier) for identifier, cell in self._cells.items())
        self._read = frozenset(self._current)
        self._touched: dict[UUID, None] = {}
        self.evidence: Evidence = {}
        self.ended: list[Ended] = []
        self.events: list[EventLine] = []
        self.features: dict[UUID, str] = {}
        self.creations: list[Creation] = []
        self.outcomes: dict[UUID, tuple[Outcome, str]] = {}

    @property
    def created(self) -> list[Obstacle]:
        """Obstacles to insert."""
        return [self._current[identifier] for identifier in self._touched if identifier not in self._read]

    @property
    def changed(self) -> list[Obstacle]:
        """Obstacles to update, with a new text in `features` when a served field changed."""
        return [self._current[identifier] for identifier in self._touched if identifier in self._read]

    def nearby(self, reach: Reach) -> tuple[Obstacle, ...]:
        """All obstacles that a report of that reach could concern, removed ones too, by id."""
        around = (self._current[identifier] for identifier in self._index.within(reach.far))
        return tuple(sorted((item for item in around if _concerns(reach, item)), key=_id))

    def put(self, after: Obstacle, by: str, at: datetime) -> ObstacleEvent | None:
        """Take an obstacle's new value, caused `by` a witness or an operator; the event when a served field changed."""
        before = self._current.get(after.id)
        if before is after:
            return None
        if before is None:
            self.creations.append(Creation(after.id, by, after.first_seen))
        elif (outcome := _outcome(before, after)) is not None:
            self.outcomes.setdefault(after.id, (outcome, by))
        if before is not None and before.version != after.version:
            self.ended.append(Ended(before, at))
        self._keep_evidence(before, after)
        cell_before = self._cells.get(after.id)
        self._place(before, after)
        self._current[after.id] = after
        self._touched[after.id] = None
        if before is not None and before.revision == after.revision:
            return None
        return self._announced(after, tile_of_cell(self._cells[after.id] if cell_before is None else cell_before), at)

    def _keep_evidence(self, before: Obstacle | None, after: Obstacle) -> None:
        known = () if before is None else before.evidence
        for witness in after.evidence:
            if witness not in known:
                self.evidence[after.id, witness.name] = witness

    def _place(self, before: Obstacle | None, after: Obstacle) -> None:
        if before is not None and before.place.position is after.place.position:
            return
        cell, cell_before = cell_of(after.place.position), self._cells.get(after.id)
        if cell == cell_before:
            return
        if cell_before is not None:
            self._index.remove(cell_before, after.id)
        self._index.add(cell, after.id)
        self._cells[after.id] = cell

    def _announced(self, after: Obstacle, tile_before: int, at: datetime) -> ObstacleEvent:
        """The event, in the log of the obstacle's tile, and in that of the tile that it has left."""
        body = self.features[after.id] = feature_text(after, self._life)
        for number in dict.fromkeys((tile_of_cell(self._cells[after.id]), tile_before)):
            tile = self.tiles[number]
            tile.version += 1
            self.events.append(EventLine(number, tile.version, after.id, body, at))
        return event_of(after, body)


def _outcome(before: Obstacle, after: Obstacle) -> Outcome | None:
    if before.witness_count > 1:
        return None
    if after.witness_count > 1:
        return "shared"
    denied = after.removed_reason == "absent" or after.inspection_state is InspectionState.NOT_AN_ISSUE
    return "refuted" if before.is_live and not after.is_live and denied else None


def _concerns(reach: Reach, obstacle: Obstacle) -> bool:
    return reach.concerns(obstacle.id, obstacle.place.position, obstacle.place.variances_m2)


_id = attrgetter("id")
