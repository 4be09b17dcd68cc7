"""The observation log: replayed it gives the same obstacles; pruned it leaves a checkpoint to begin with."""

from __future__ import annotations

import gzip
import random
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any
from uuid import UUID

import pytest
from sqlalchemy import select

from contract.history import Confirm, Dismiss, Inspect
from contract.observation import ObservationReport, State
from contract.obstacle import InspectionState
from server.ingesting.group import Outcome, decide_together
from server.ingesting.parcel import Parcel
from server.life.policy import COOPERATION
from server.log import checkpoint
from server.log.checkpoint import CheckpointError
from server.log.observation_log import LogGapError
from server.log.pruning import RetentionError, prune
from server.log.replay import ReplayError, replay
from server.operators import Operators
from server.storage import schema, tables
from server.storage.audit import Order
from server.storage.database import Database
from server.trust.keys import Keys, Role
from server.upkeep import Upkeep
from tests.unit.server.making import HOUR, PATRAS, absent, detection, message

START = datetime(2026, 6, 1, tzinfo=UTC)
DECIDED = (tables.tile, tables.obstacle, tables.obstacle_version, tables.witness, tables.creation, tables.event)
PLACES_M = ((0.0, 0.0), (3.0, 1.0), (60.0, 40.0), (-45.0, 80.0))


class City:
    """Vehicles, an operator and the sweeper at work on one database, as of moments of their own."""

    def __init__(self, database: Database, seed: int) -> None:
        self.database = database
        self._random = random.Random(seed)  # noqa: S311  # a story, not a secret
        self._operators = Operators(database, COOPERATION.life, 5, lambda _: None)
        self._number = 0
        self.now = START

    async def live(self, steps: int) -> None:
        for _ in range(steps):
            self.now += timedelta(minutes=self._random.uniform(20, 90))
            await self._random.choices([self._report, self._operate, self._sweep], [10, 1, 1])[0]()

    async def obstacles(self, state: State | None = None) -> Sequence[UUID]:
        query = select(tables.obstacle.c.id).order_by(tables.obstacle.c.id)
        if state is not None:
            query = query.where(tables.obstacle.c.state == state.value)
        async with self.database.read() as connection:
            return (await connection.execute(query)).scalars().all()

    async def _report(self) -> None:
        parcels = []
        for _ in range(self._random.choice([1, 1, 3])):
            sent = await self._message()
            vehicle = f"ego{self._random.randrange(5)}"
            parcels.append(Parcel(sent, self.now, self.now, vehicle, vehicle, sent.model_dump_json()))
        outcomes = await decide_together(self.database, parcels, COOPERATION, {"ego4"})
        assert all(isinstance(outcome, Outcome) for outcome in outcomes)

    async def _message(self) -> ObservationReport:
        self._number += 1
        at = self.now - timedelta(minutes=self._random.uniform(0, 200))
        known = await self.obstacles()
        looked = self._random.sample(list(known), k=min(len(known), self._random.randrange(3)))
        seen = self._random.sample(PLACES_M, k=self._random.randrange(3))
        return message(
            *(detection(e + self._random.gauss(0, 1), n, self._random.randrange(800, 1400)) for e, n in seen),
            inspections=tuple(map(absent, looked)),
            at=at,
            number=self._number,
        )

    async def _operate(self) -> None:
        live = [*await self.obstacles(State.CANDIDATE), *await self.obstacles(State.CONFIRMED)]
        if live:
            deed = self._random.choice(
                [
                    Confirm(action="confirm"),
                    Dismiss(action="dismiss", note="a shadow"),
                    Inspect(action="inspection_state", inspection_state=InspectionState.SCHEDULED),
                    "delete",
                ]
            )
            await self._operators.repeat(Order(self._random.choice(live), deed, "operator", None, None), self.now)

    async def _sweep(self) -> None:
        for identifier in await self.obstacles():
            await self._operators.repeat(Order(identifier, "expire", "sweeper", None, None), self.now)


async def rows(database: Database) -> dict[str, list[dict[str, Any]]]:
    async with database.read() as connection:
        return {
            table.name: [
                dict(row)
                for row in (await connection.execute(select(table).order_by(*table.primary_key.columns))).mappings()
            ]
            for table in DECIDED
        }


async def fresh(path: Path) -> Database:
    database = Database.open(f"sqlite+aiosqlite:///{path}")
    await schema.upgrade(database)
    return database


@pytest.mark.parametrize("seed", [1, 2])
async def test_a_replay_into_an_empty_database_gives_the_same_obstacles(
    database_url: str, tmp_path: Path, seed: int
) -> None:
    source, target = Database.open(database_url), await fresh(tmp_path / "target.sqlite3")
    await Keys(source, None).create(Role.VEHICLE, "ego1")
    await City(source, seed).live(60)
    lines = []
    done = await replay(source, target, COOPERATION, None, lambda: lines.append(1))
    wanted = await rows(source)
    assert await rows(target) == wanted
    assert {row["state"] for row in wanted["obstacle"]} >= {"confirmed", "removed"}
    assert (done.different, done.reports + done.acts) == (0, len(lines))
    assert done.acts > 0
    assert len(await Keys(target, None).all()) == 1
    with pytest.raises(ReplayError, match="fresh database"):
        await replay(source, target, COOPERATION, None, lambda: None)
    for database in (source, target):
        await database.close()


async def test_a_replay_from_a_checkpoint_gives_the_same_as_the_whole_log(database_url: str, tmp_path: Path) -> None:
    source, city = Database.open(database_url), None
    city = City(source, 3)
    await city.live(30)
    path = tmp_path / "checkpoint.jsonl.gz"
    pruned = await prune(source, timedelta(days=7), path, city.now + timedelta(days=8), COOPERATION.times)
    assert pruned.reports > 0
    assert pruned.checkpointed > 0
    await city.live(30)
    target = await fresh(tmp_path / "target.sqlite3")
    done = await replay(source, target, COOPERATION, path, lambda: None)
    wanted = await rows(source)
    # Events before the checkpoint stay in the source: the checkpoint holds what they led to.
    replayed = await rows(target)
    assert {name: replayed[name] for name in replayed if name != "event"} == {
        name: wanted[name] for name in wanted if name != "event"
    }
    assert replayed["event"] == [row for row in wanted["event"] if row in replayed["event"]]
    assert done.different == 0
    other = await fresh(tmp_path / "other.sqlite3")
    with pytest.raises(LogGapError, match="gap"):
        await replay(source, other, COOPERATION, None, lambda: None)
    for database in (source, target, other):
        await database.close()


async def test_reports_are_not_forgotten_while_they_may_be_repeated(tmp_path: Path) -> None:
    database = await fresh(tmp_path / "a.sqlite3")
    with pytest.raises(RetentionError, match="at least 7 days"):
        await prune(database, timedelta(days=6), tmp_path / "c.gz", START, COOPERATION.times)
    await database.close()


@pytest.mark.parametrize("damage", ["cut", "other", "nothing"])
async def test_a_damaged_checkpoint_is_refused(tmp_path: Path, damage: str) -> None:
    source, target = await fresh(tmp_path / "a.sqlite3"), await fresh(tmp_path / "b.sqlite3")
    await City(source, 4).live(10)
    path = tmp_path / "c.gz"
    await checkpoint.save(source, path)
    lines = gzip.decompress(path.read_bytes()).splitlines(keepends=True)
    texts = {"cut": b"".join(lines[:-2]), "other": b'{"format": "something else"}\n', "nothing": b""}
    path.write_bytes(gzip.compress(texts[damage]))
    with pytest.raises(CheckpointError):
        await replay(source, target, COOPERATION, path, lambda: None)
    async with target.read() as connection:
        assert (await connection.execute(select(tables.obstacle))).first() is None
    for database in (source, target):
        await database.close()


async def test_what_has_decayed_is_removed_by_the_sweeper_and_may_come_back_as_its_successor(database_url: str) -> None:
    database = Database.open(database_url)
    operators = Operators(database, COOPERATION.life, 5, lambda _: None)
    upkeep = Upkeep(database, operators, COOPERATION.life)
    first = await _taken(database, message(detection(), at=START), START)
    assert await upkeep.sweep(START + timedelta(days=1)) == 0
    assert await upkeep.sweep(START + timedelta(days=1000)) == 1
    later = START + timedelta(days=1001)
    again = await _taken(database, message(detection(), at=later, number=1), later)
    assert [outcome.result.detections[0].reason for outcome in (first, again)] == ["new", "succeeds-a-removed-one"]
    await database.close()


async def test_a_witness_whose_creations_others_refute_is_only_logged(database_url: str) -> None:
    database = Database.open(database_url)
    upkeep = Upkeep(database, Operators(database, COOPERATION.life, 5, lambda _: None), COOPERATION.life)
    for number in range(5):
        await upkeep.judge()
        assert upkeep.distrusted == frozenset()
        at = START + number * 3 * HOUR
        created = await _taken(database, message(detection(25.0 * number, 0), at=at, number=number), at, "liar")
        identifier = created.result.detections[0].obstacle_id
        assert identifier is not None
        looked = message(inspections=(absent(identifier),), vehicle="ego2", at=at + HOUR, number=number)
        refuted = await _taken(database, looked, at + HOUR, "honest")
        assert refuted.result.inspections[0].removed
    await upkeep.judge()
    assert upkeep.distrusted == {"liar"}
    at = START + 20 * HOUR
    sent = message(detection(-80, 0), at=at, number=99)
    parcel = Parcel(sent, at, at, "liar", "liar", sent.model_dump_json())
    (outcome,) = await decide_together(database, [parcel], COOPERATION, upkeep.distrusted)
    assert isinstance(outcome, Outcome)
    assert outcome.result.detections[0].reason == "witness-distrusted"
    await database.close()


async def test_nobody_is_at_two_places_at_once(database_url: str) -> None:
    database = Database.open(database_url)
    far = PATRAS.model_copy(update={"latitude_deg": PATRAS.latitude_deg + 0.1})
    at = START + timedelta(seconds=60)
    await _taken(database, message(detection(), at=START), START)
    jumped = await _taken(database, message(detection(), at=at, position=far, number=1), at)
    # Ten minutes later the place is not held against it any more.
    drove = await _taken(database, message(detection(), at=START + HOUR, position=far, number=2), START + HOUR)
    assert [(o.result.status.value, o.result.reason) for o in (jumped, drove)] == [
        ("rejected", "impossible-speed"),
        ("accepted", None),
    ]
    await database.close()


async def _taken(database: Database, sent: ObservationReport, at: datetime, witness: str = "ego1") -> Outcome:
    parcel = Parcel(sent, at, at, witness, witness, sent.model_dump_json())
    (outcome,) = await decide_together(database, [parcel], COOPERATION)
    assert isinstance(outcome, Outcome)
    return outcome
