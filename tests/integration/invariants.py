"""What must hold in any database of the service, whatever has happened to it."""

from __future__ import annotations

import asyncio
import json
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from sqlalchemy import RowMapping, Table, select

from contract.observation import ReportResult
from contract.obstacle import ObstacleFeature
from server.storage import tables
from server.storage.database import Database

_COUNTED = {"created", "kept", "updated"}
Rows = list[RowMapping]


@dataclass(frozen=True)
class Stored:
    """All rows that the invariants are about."""

    tiles: Rows
    obstacles: Rows
    events: Rows
    reports: Rows
    actions: Rows

    @property
    def answers(self) -> dict[str, ReportResult]:
        """What was answered, by report id."""
        return {str(row["report_id"]): ReportResult.model_validate_json(row["answer"]) for row in self.reports}

    @property
    def sightings(self) -> int:
        """Sightings of all obstacles, merged ones counted where they went."""
        return sum(row["sightings"] for row in self.obstacles if row["merged_into"] is None)

    @property
    def counted_detections(self) -> int:
        """Detections that were answered as seen."""
        return sum(item.decision in _COUNTED for answer in self.answers.values() for item in answer.detections)


def stored(database_url: str) -> Stored:
    """Everything in a database; the caller has no event loop."""
    return asyncio.run(read_all(database_url))


async def read_all(database_url: str) -> Stored:
    database = Database.open(database_url)

    async def rows(table: Table) -> Rows:
        return list((await connection.execute(select(table))).mappings().all())

    try:
        async with database.snapshot() as connection:
            wanted = (tables.tile, tables.obstacle, tables.event, tables.report, tables.action)
            return Stored(*[await rows(table) for table in wanted])
    finally:
        await database.close()


def assert_consistent(found: Stored) -> None:
    """Sequences without gaps, one event a revision, and served texts that say what their rows say."""
    _assert_tiles_count_their_events(found)
    _assert_one_event_a_revision(found)
    _assert_places_in_the_log_are_taken_once(found)
    for row in found.obstacles:
        feature = ObstacleFeature.model_validate_json(row["feature"])
        told = (feature.id, feature.properties.revision, feature.properties.version, feature.properties.state)
        assert told == (row["id"], row["revision"], row["version"], row["state"])


def _assert_tiles_count_their_events(found: Stored) -> None:
    seqs: dict[int, list[int]] = defaultdict(list)
    for row in found.events:
        seqs[row["tile"]].append(row["seq"])
    for row in found.tiles:
        assert sorted(seqs.pop(row["tile"], [])) == list(range(1, row["version"] + 1)), f"gaps in tile {row['tile']}"
    assert not seqs, "events of tiles without a row"


def _assert_one_event_a_revision(found: Stored) -> None:
    bodies: dict[Any, dict[int, str]] = defaultdict(dict)
    for row in found.events:
        revision = ObstacleFeature.model_validate_json(row["body"]).properties.revision
        # An obstacle that moves to another tile is announced in both, in the same words.
        assert bodies[row["obstacle_id"]].setdefault(revision, row["body"]) == row["body"]
    for row in found.obstacles:
        revisions = bodies.pop(row["id"], {})
        assert sorted(revisions) == list(range(1, row["revision"] + 1)), f"revisions of {row['id']}"
        assert revisions[row["revision"]] == row["feature"]
    assert not bodies, "events of obstacles that are not there"


def _assert_places_in_the_log_are_taken_once(found: Stored) -> None:
    places = Counter(_places(found))
    assert not [place for place, times in places.items() if times > 1], "two lines at one place of a tile's order"
    for row in found.tiles:
        taken = sorted(lock_seq for tile, lock_seq in places if tile == row["tile"])
        assert taken == list(range(1, row["lock_seq"] + 1)), f"the log of tile {row['tile']} is not whole"


def _places(found: Stored) -> Iterator[tuple[int, int]]:
    for row in [*found.reports, *found.actions]:
        held = row["tiles"]
        for tile, lock_seq in (json.loads(held) if isinstance(held, str) else held).items():
            yield int(tile), lock_seq
