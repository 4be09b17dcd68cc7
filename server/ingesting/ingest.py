"""Group commit: reports that wait while a transaction commits share the next one. An answer comes after its commit."""

from __future__ import annotations

import asyncio
import logging
import random
from collections import deque
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, field

from sqlalchemy.exc import DBAPIError

from contract.observation import ReportResult, ReportStatus
from server.counters import IngestCounts
from server.errors import StorageError, UnavailableError
from server.ingesting import answers
from server.ingesting.group import Outcome, Outcomes
from server.ingesting.parcel import Parcel
from server.storage.database import is_worth_a_retry
from server.storage.features import ObstacleEvent

# Commits and statements fall on all reports of a group: at full load 64 cost each a fifth more. Deciding as many takes
# a fifth of a second, for which the first waits for the last.
GREATEST_GROUP = 256
# Reports of a second at full load: what waits longer than a vehicle does is better refused at once.
_GREATEST_BACKLOG = 8_192
_FIRST_PAUSE_S, _GREATEST_PAUSE_S = 0.01, 0.5
_LOG = logging.getLogger(__name__)

Decide = Callable[[Sequence[Parcel]], Awaitable[Outcomes]]


@dataclass(slots=True, eq=False)
class _Waiting:
    parcel: Parcel
    answer: asyncio.Future[ReportResult] = field(default_factory=lambda: asyncio.get_running_loop().create_future())


class Ingest:
    """The reports of this process on their way into the database, in the order of their arrival."""

    def __init__(self, decide: Decide, deadline_s: float, publish: Callable[[ObstacleEvent], None]) -> None:
        self._decide, self._deadline_s, self._publish = decide, deadline_s, publish
        self._waiting: deque[_Waiting] = deque()
        self.counts = IngestCounts()
        self._arrived = asyncio.Event()

    @property
    def backlog(self) -> int:
        """Reports that wait."""
        return len(self._waiting)

    async def take(self, parcels: Sequence[Parcel]) -> list[ReportResult]:
        """Answers to reports, in their order; `retry` for those the database did not take in time.

        A report whose sender has given up may still be decided: its repetition is then answered as a duplicate.
        """
        if self.backlog + len(parcels) > _GREATEST_BACKLOG:
            raise UnavailableError("too many reports are waiting; send them again")
        mine = [_Waiting(item) for item in parcels]
        self._waiting.extend(mine)
        self._arrived.set()
        try:
            await asyncio.wait([item.answer for item in mine], timeout=self._deadline_s)
            return [_answer(item) for item in mine]
        finally:
            for item in mine:
                item.answer.cancel()

    async def run(self) -> None:
        """Decide what arrives until cancelled."""
        while True:
            await self._arrived.wait()
            group = self._next_group()
            if group:
                await self._settle(group)

    def _next_group(self) -> list[_Waiting]:
        group: list[_Waiting] = []
        while self._waiting and len(group) < GREATEST_GROUP:
            item = self._waiting.popleft()
            if not item.answer.done():
                group.append(item)
        if not self._waiting:
            self._arrived.clear()
        return group

    async def _settle(self, group: list[_Waiting]) -> None:
        """Try a group until it commits or nobody waits for it; one that the database refuses is tried one by one."""
        pause_s = _FIRST_PAUSE_S
        while group := [item for item in group if not item.answer.done()]:
            try:
                async with asyncio.timeout(self._deadline_s):
                    outcomes = await self._decide([item.parcel for item in group])
            except StorageError as error:
                _refuse(group, error)
                return
            except (TimeoutError, UnavailableError):
                pass
            except Exception as error:  # the worker must outlive whatever a report or a driver does
                if not (isinstance(error, DBAPIError) and is_worth_a_retry(error)):
                    await self._settle_singly(group, error)
                    return
            else:
                self.counts.groups.observe(len(group))
                self._tell(group, outcomes)
                return
            self.counts.attempts_failed += 1
            await asyncio.sleep(random.uniform(0, pause_s))  # noqa: S311  # jitter, not a secret
            pause_s = min(2 * pause_s, _GREATEST_PAUSE_S)

    async def _settle_singly(self, group: list[_Waiting], error: Exception) -> None:
        if len(group) > 1:
            for item in group:
                await self._settle([item])
        else:
            _refuse(group, error)

    def _tell(self, group: list[_Waiting], outcomes: Outcomes) -> None:
        for item, outcome in zip(group, outcomes, strict=True):
            if isinstance(outcome, Outcome):
                self.counts.count(outcome.result)
                self._tell_others(outcome.events)
            if item.answer.done():
                continue
            if isinstance(outcome, Outcome):
                item.answer.set_result(outcome.result)
            else:
                item.answer.set_exception(outcome)

    def _tell_others(self, events: Sequence[ObstacleEvent]) -> None:
        for event in events:
            try:
                self._publish(event)
            except Exception:  # it is committed: whoever cannot be told must not cost its sender the answer
                _LOG.exception("an event of obstacle %s reached nobody at this server", event.obstacle_id)


def _refuse(group: list[_Waiting], error: Exception) -> None:
    for item in group:
        if not item.answer.done():
            item.answer.set_exception(error)


def _answer(item: _Waiting) -> ReportResult:
    if item.answer.done():
        return item.answer.result()
    return answers.refused(item.parcel.message, ReportStatus.RETRY, "busy")
