"""One transaction for many reports: lock, read, decide each in memory, write all in bulk, commit, then events."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from contract.observation import ReportResult, ReportStatus
from server import rules
from server.ingesting import answers, parcel
from server.ingesting.parcel import Parcel
from server.life.plausibility import LastPlace, is_too_fast, place_of
from server.life.policy import Policy
from server.life.reach import NOWHERE, Reach, reach_of
from server.storage import writing
from server.storage.candidates import Asked
from server.storage.database import Database
from server.storage.features import ObstacleEvent
from server.storage.reads import ReportName
from server.storage.repository import Answered, Repository
from server.storage.working_set import WorkingSet

T = TypeVar("T")
R = TypeVar("R")
# Reports that are decided without a pause: 10 ms, as long as a query nearby may wait for them.
_AT_ONCE = 16


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a report, and the events to publish after the commit."""

    result: ReportResult
    events: tuple[ObstacleEvent, ...] = ()


Outcomes = list[Outcome | Exception]
"""For each report of a group; an exception is a fault of ours in deciding that one report, which changed nothing."""


async def decide_together(
    database: Database, parcels: Sequence[Parcel], policy: Policy, distrusted: Container[str] = frozenset()
) -> Outcomes:
    """Decide reports in order and commit what they change; it has committed when this returns.

    What `distrusted` witnesses report is answered and logged only.
    """
    opened = await _each(lambda item: _opened(item, policy, distrusted), parcels)
    return await decide_opened(database, opened, policy)


async def decide_opened(database: Database, opened: Sequence[Opened], policy: Policy) -> Outcomes:
    """The same for reports that are rejected or believed already."""
    parcels = [item.parcel for item in opened]
    async with database.write() as connection:
        repository = Repository(connection, policy.life)
        held = await repository.hold(number for item in opened for number in item.reach.tiles)
        known = await repository.answered(item.name for item in parcels)
        places = await repository.last_places({item.witness for item in parcels})
        changes = await repository.working_set(held, [Asked(item.reach, item.parcel.witness) for item in opened])
        group = _Group(changes, known, places, policy)
        outcomes = await _each(group.decided, opened)
        await writing.log(connection, group.lines)
        # A group without a new line (repetitions, rejections) leaves nothing to be ordered by.
        if group.lines:
            await writing.write(connection, changes, policy.life)
            await writing.move(connection, group.moved, places)
    return outcomes


async def _each(act: Callable[[T], R], items: Sequence[T]) -> list[R]:
    """Results for items in order, with pauses in which others are served."""
    results: list[R] = []
    for first in range(0, len(items), _AT_ONCE):
        results += map(act, items[first : first + _AT_ONCE])
        await asyncio.sleep(0)
    return results


@dataclass(frozen=True, slots=True)
class Opened:
    """A parcel with its report, or why that is rejected as a whole."""

    parcel: Parcel
    report: rules.Report | str
    reach: Reach


def _opened(item: Parcel, policy: Policy, distrusted: Container[str]) -> Opened:
    report = parcel.opened(item, policy, distrusted)
    # Only what can change something locks: at a pole the reach of a report is a whole row of tiles.
    return Opened(item, report, NOWHERE if isinstance(report, str) else reach_of(item.message, policy))


class _Group:
    """The reports of one transaction, decided one after the other on the same working set."""

    def __init__(
        self,
        changes: WorkingSet,
        known: dict[ReportName, Answered],
        places: Mapping[str, LastPlace],
        policy: Policy,
    ) -> None:
        self._changes, self._known, self._places, self._policy = changes, known, places, policy
        self.lines: list[writing.LoggedReport] = []
        self.moved: dict[str, LastPlace] = {}

    def decided(self, opened: Opened) -> Outcome | Exception:
        """Decide one report; what fails in it must not fail the others."""
        item, report = opened.parcel, opened.report
        if earlier := self._known.get(item.name):
            return Outcome(_answered_before(item, earlier))
        if isinstance(report, str):
            return Outcome(answers.refused(item.message, ReportStatus.REJECTED, report))
        here = place_of(item.message, report.observed_at)
        last = self.moved.get(item.witness) or self._places.get(item.witness)
        if last is not None and is_too_fast(last, here, self._policy.plausibility):
            return Outcome(answers.refused(item.message, ReportStatus.REJECTED, "impossible-speed"))
        try:
            nearby = self._changes.nearby(opened.reach)
            decisions = rules.decide(report, nearby, item.received_at, self._policy)
            result = answers.accepted(item.message, decisions)
        except Exception as error:  # one report's failure is answered as such, and only to its sender
            return error
        self._log(opened, report, result)
        if last is None or here.observed_at > last.observed_at:
            self.moved[item.witness] = here
        return Outcome(result, self._taken(decisions, item))

    def _taken(self, decisions: list[rules.Decision], item: Parcel) -> tuple[ObstacleEvent, ...]:
        after = {decision.obstacle.id: decision.obstacle for decision in decisions if decision.obstacle is not None}
        events = [self._changes.put(obstacle, item.witness, item.received_at) for obstacle in after.values()]
        return tuple(event for event in events if event is not None)

    def _log(self, opened: Opened, report: rules.Report, result: ReportResult) -> None:
        item = opened.parcel
        for number in opened.reach.tiles:
            self._changes.tiles[number].lock_seq += 1
        line = writing.LoggedReport(
            key_id=item.key_id,
            report_id=item.message.report_id,
            body_sha256=item.body_sha256,
            witness=item.witness,
            observed_at=report.observed_at,
            received_at=item.received_at,
            body=item.body,
            answer=result.model_dump_json(),
            tiles={number: self._changes.tiles[number].lock_seq for number in opened.reach.tiles},
        )
        self.lines.append(line)
        self._known[item.name] = Answered(line.body_sha256, line.answer)


def _answered_before(item: Parcel, earlier: Answered) -> ReportResult:
    if earlier.body_sha256 != item.body_sha256:
        return answers.refused(item.message, ReportStatus.REJECTED, "conflict")
    answer = ReportResult.model_validate_json(earlier.answer)
    return answer.model_copy(update={"status": ReportStatus.DUPLICATE})
