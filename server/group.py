"""One transaction for many reports: lock, read, decide each in memory, write all in bulk, commit, then events."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from contract.observation import ReportResult, ReportStatus
from server import answers, parcel, quadkey, rules, writing
from server.database import Database
from server.features import ObstacleEvent
from server.parcel import Parcel
from server.policy import Policy
from server.repository import Answered, ReportName, Repository
from server.working_set import WorkingSet


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a report, and the events to publish after the commit."""

    result: ReportResult
    events: tuple[ObstacleEvent, ...] = ()


Outcomes = list[Outcome | Exception]
"""For each report of a group; an exception is a fault of ours in deciding that one report, which changed nothing."""


async def decide_together(database: Database, parcels: Sequence[Parcel], policy: Policy) -> Outcomes:
    """Decide reports in order and commit what they change; it has committed when this returns."""
    reports = [parcel.opened(item, policy) for item in parcels]
    # Only what can change something locks: at a pole the area of a report is a whole row of tiles.
    areas = [
        parcel.area(item.message, policy)
        for item, report in zip(parcels, reports, strict=True)
        if not isinstance(report, str)
    ]
    async with database.write() as connection:
        repository = Repository(connection, policy.life)
        held = await repository.hold(number for area in areas for number in quadkey.tiles(*area))
        known = await repository.answered(item.name for item in parcels)
        changes = await repository.working_set(held, areas, (item.witness for item in parcels))
        group = _Group(changes, known, policy)
        outcomes = [group.decided(item, report) for item, report in zip(parcels, reports, strict=True)]
        await writing.log(connection, group.lines)
        # A group without a new line (repetitions, rejections) leaves nothing to be ordered by.
        if group.lines:
            await writing.write(connection, changes, policy.life, parcels[-1].received_at)
    return outcomes


class _Group:
    """The reports of one transaction, decided one after the other on the same working set."""

    def __init__(self, changes: WorkingSet, known: dict[ReportName, Answered], policy: Policy) -> None:
        self._changes, self._known, self._policy = changes, known, policy
        self.lines: list[writing.LoggedReport] = []

    def decided(self, item: Parcel, report: rules.Report | str) -> Outcome | Exception:
        """Decide one report; what fails in it must not fail the others."""
        if earlier := self._known.get(item.name):
            return Outcome(_answered_before(item, earlier))
        if isinstance(report, str):
            return Outcome(answers.refused(item.message, ReportStatus.REJECTED, report))
        try:
            nearby = self._changes.nearby(*parcel.area(item.message, self._policy))
            decisions = rules.decide(report, nearby, item.received_at, self._policy)
            result = answers.accepted(item.message, decisions)
        except Exception as error:  # one report's failure is answered as such, and only to its sender
            return error
        return Outcome(result, self._taken(item, report, decisions, result))

    def _taken(
        self, item: Parcel, report: rules.Report, decisions: list[rules.Decision], result: ReportResult
    ) -> tuple[ObstacleEvent, ...]:
        after = {decision.obstacle.id: decision.obstacle for decision in decisions if decision.obstacle is not None}
        events = [self._changes.put(obstacle) for obstacle in after.values()]
        line = self._line(item, report, result)
        self.lines.append(line)
        self._known[item.name] = Answered(line.body_sha256, line.answer)
        return tuple(event for event in events if event is not None)

    def _line(self, item: Parcel, report: rules.Report, result: ReportResult) -> writing.LoggedReport:
        around = quadkey.tiles(*parcel.area(item.message, self._policy))
        for number in around:
            self._changes.tiles[number].lock_seq += 1
        return writing.LoggedReport(
            key_id=item.key_id,
            report_id=item.message.report_id,
            body_sha256=item.body_sha256,
            witness=item.witness,
            observed_at=report.observed_at,
            received_at=item.received_at,
            body=item.body,
            answer=result.model_dump_json(),
            tiles={number: self._changes.tiles[number].lock_seq for number in around},
        )


def _answered_before(item: Parcel, earlier: Answered) -> ReportResult:
    if earlier.body_sha256 != item.body_sha256:
        return answers.refused(item.message, ReportStatus.REJECTED, "conflict")
    answer = ReportResult.model_validate_json(earlier.answer)
    return answer.model_copy(update={"status": ReportStatus.DUPLICATE})
