"""The log replayed into an empty database: the same obstacles, with the same ids."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from sqlalchemy import select

from contract.observation import ReportResult
from server.errors import ServiceError
from server.ingesting.group import Outcome, decide_opened
from server.life.policy import Policy
from server.log import checkpoint, observation_log
from server.log.observation_log import Line
from server.operators import Operators
from server.storage import tables
from server.storage.database import Database

_DEADLINE_S = 60.0
_IDENTITIES = (tables.secret, tables.api_key)


class ReplayError(ServiceError):
    """The log cannot be replayed there, or not as it was."""


@dataclass(frozen=True, slots=True)
class Replayed:
    """What a replay did; `different` reports were answered otherwise than the log says."""

    reports: int
    acts: int
    different: int


async def replay(
    source: Database, target: Database, policy: Policy, start: Path | None, progress: Callable[[], None]
) -> Replayed:
    """Decide the source's log again in the target, after the checkpoint `start`; `progress` is called for every line.

    Keys and secrets come along, so that the target can take the source's place. Raises `ReplayError` when the target is
    not empty, `LogGapError` when the log is not whole, `CheckpointError` when the checkpoint cannot be read.
    """
    async with source.read() as connection:
        identities = {table: (await connection.execute(select(table))).mappings().all() for table in _IDENTITIES}
    async with target.write() as connection:
        for table in (*_IDENTITIES, tables.obstacle, tables.report):
            if (await connection.execute(select(table).limit(1))).first() is not None:
                raise ReplayError(f"the target's table {table.name} is not empty: replay into a fresh database")
        held = {} if start is None else await checkpoint.load(start, connection)
        for table, rows in identities.items():
            if rows:
                await connection.execute(table.insert(), [dict(row) for row in rows])
    player = _Player(target, policy)
    async for line in observation_log.in_order(source, held):
        await player.play(line)
        progress()
    return Replayed(player.reports, player.acts, player.different)


class _Player:
    def __init__(self, target: Database, policy: Policy) -> None:
        self._target = target
        # Whoever was too fast was not logged; lines of distant tiles may come in another order now.
        self._policy = replace(policy, plausibility=replace(policy.plausibility, greatest_speed_mps=math.inf))
        self._operators = Operators(target, policy.life, _DEADLINE_S, lambda _: None)
        self.reports = self.acts = self.different = 0

    async def play(self, line: Line) -> None:
        """Decide one line again."""
        if not line.is_report:
            self.acts += 1
            await self._operators.repeat(observation_log.order_of(line), line.at)
            return
        self.reports += 1
        opened = observation_log.report_of(line, self._policy)
        (outcome,) = await decide_opened(self._target, [opened], self._policy)
        if not isinstance(outcome, Outcome):
            raise outcome
        if outcome.result != ReportResult.model_validate_json(line.row["answer"]):
            self.different += 1
