"""What the service does: takes reports, answers what is near. Transactions begin and end here, events follow."""

from __future__ import annotations

import asyncio
import hashlib
import math
import random
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from uuid import UUID

from sqlalchemy.exc import DBAPIError
from sqlalchemy.ext.asyncio import AsyncConnection

from contract.geometry import LatLon
from contract.observation import (
    ObservationBatch,
    ObservationBatchResult,
    ObservationReport,
    ReportResult,
    ReportStatus,
)
from contract.obstacle import ObstacleFeature
from server import answers, quadkey, rules
from server.database import Database, is_worth_a_retry
from server.errors import ObstacleNotFoundError, UnavailableError
from server.features import ObstacleEvent, event_of, feature_of
from server.geodesy import distance_m
from server.keys import Caller, witness_name
from server.obstacle import Obstacle
from server.plausibility import clock_correction, report_rejection
from server.policy import Policy
from server.repository import LoggedReport, Repository

_FIRST_PAUSE_S, _GREATEST_PAUSE_S = 0.01, 0.5


@dataclass(frozen=True, slots=True)
class _Parcel:
    """A report, who sent it, when it was received, and its hash."""

    message: ObservationReport
    sent_at: datetime
    received_at: datetime
    key_id: str
    witness: str
    body: str

    @property
    def body_sha256(self) -> str:
        return hashlib.sha256(self.body.encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class _Outcome:
    result: ReportResult
    events: tuple[ObstacleEvent, ...] = ()


class Service:
    """The obstacle service on one database. `publish` is called with every event, after its commit."""

    def __init__(
        self,
        database: Database,
        policy: Policy,
        secret: str,
        write_deadline_s: float,
        publish: Callable[[ObstacleEvent], None],
    ) -> None:
        self._database = database
        self._policy = policy
        self._secret = secret
        self._write_deadline_s = write_deadline_s
        self._publish = publish

    async def observe(self, caller: Caller, batch: ObservationBatch) -> ObservationBatchResult:
        """Take each report of a batch in order, each in a transaction of its own.

        Raises `UnavailableError` when the database took none of them in time.
        """
        caller.must_be_able_to_post()
        received_at = datetime.now(UTC)
        deadline_s = time.monotonic() + self._write_deadline_s
        parcels = [self._parcel(caller, batch.sent_at, received_at, report) for report in batch.reports]
        results = [await self._take(parcel, deadline_s) for parcel in parcels]
        if all(result.status is ReportStatus.RETRY for result in results):
            raise UnavailableError("the database did not take the reports in time; send them again")
        return ObservationBatchResult(results=tuple(results))

    async def near(self, centre: LatLon, radius_m: float, limit: int | None = None) -> tuple[ObstacleFeature, ...]:
        """Live obstacles within `radius_m` (geodesic) of a place, nearest first."""
        async with self._database.read() as connection:
            found = await self._repository(connection).near(centre, radius_m, datetime.now(UTC))
        by_distance = sorted((distance_m(item.place.position, centre), index) for index, item in enumerate(found))
        inside = [found[index] for apart_m, index in by_distance if apart_m <= radius_m]
        return tuple(feature_of(obstacle, self._policy.life) for obstacle in inside[:limit])

    async def obstacle(self, identifier: UUID) -> ObstacleFeature:
        """One obstacle, also a removed one."""
        async with self._database.read() as connection:
            found = await self._repository(connection).obstacle(identifier)
        if found is None:
            raise ObstacleNotFoundError(f"there is no obstacle {identifier}")
        return feature_of(found, self._policy.life)

    async def ping(self) -> None:
        """Fail if the database does not answer."""
        async with self._database.read() as connection:
            await self._repository(connection).ping()

    async def _take(self, parcel: _Parcel, deadline_s: float) -> ReportResult:
        """Try a report's transaction until it commits or the deadline has passed, then publish."""
        pause_s = _FIRST_PAUSE_S
        while time.monotonic() < deadline_s:
            try:
                async with asyncio.timeout(deadline_s - time.monotonic()):
                    outcome = await self._attempt(parcel)
            except TimeoutError:
                break
            except UnavailableError:
                await _pause(pause_s)
            except DBAPIError as error:
                if not is_worth_a_retry(error):
                    raise
                await _pause(pause_s)
            else:
                for event in outcome.events:
                    self._publish(event)
                return outcome.result
            pause_s = min(2 * pause_s, _GREATEST_PAUSE_S)
        return answers.refused(parcel.message, ReportStatus.RETRY, "busy")

    async def _attempt(self, parcel: _Parcel) -> _Outcome:
        """One transaction: lock, read, decide, write. It has committed when this returns."""
        async with self._database.write() as connection:
            repository = self._repository(connection)
            report = self._report(parcel)
            centre, radius_m = self._area(parcel.message)
            # Only what can change something locks: at a pole the area of a report is a whole row of tiles.
            held = [] if isinstance(report, str) else await repository.lock(quadkey.tiles(centre, radius_m))
            if earlier := await repository.logged(parcel.key_id, parcel.message.report_id):
                return _Outcome(_answered_before(parcel, earlier))
            if isinstance(report, str):
                return _Outcome(answers.refused(parcel.message, ReportStatus.REJECTED, report))
            nearby = await repository.candidates(centre, radius_m, parcel.witness)
            decisions = rules.decide(report, nearby, parcel.received_at, self._policy)
            events = await self._write(repository, nearby, decisions, parcel.received_at)
            result = answers.accepted(parcel.message, decisions)
            await repository.log(_line(parcel, report, result, held))
        return _Outcome(result, events)

    async def _write(
        self, repository: Repository, nearby: tuple[Obstacle, ...], decisions: list[rules.Decision], now: datetime
    ) -> tuple[ObstacleEvent, ...]:
        """Write what the decisions changed; an event for each obstacle with a new revision."""
        before = {obstacle.id: obstacle for obstacle in nearby}
        after = {decision.obstacle.id: decision.obstacle for decision in decisions if decision.obstacle is not None}
        events = []
        for identifier, obstacle in after.items():
            known = before.get(identifier)
            if known is None:
                await repository.create(obstacle)
            elif known is not obstacle:
                await repository.replace(known, obstacle, now)
            if known is None or known.revision != obstacle.revision:
                event = event_of(obstacle, self._policy.life)
                await repository.append_event(obstacle, event.feature.model_dump_json(), now)
                events.append(event)
        return tuple(events)

    def _parcel(self, caller: Caller, sent_at: datetime, received_at: datetime, report: ObservationReport) -> _Parcel:
        return _Parcel(
            message=report,
            sent_at=sent_at,
            received_at=received_at,
            key_id=caller.key_id,
            witness=witness_name(caller, report.pseudonym, self._secret),
            body=report.model_dump_json(),
        )

    def _report(self, parcel: _Parcel) -> rules.Report | str:
        """The report at its corrected time, or why it is rejected."""
        policy, message = self._policy, parcel.message
        correction = clock_correction(parcel.sent_at, parcel.received_at, policy.times)
        if correction is None:
            return "clock-skew"
        age = parcel.received_at - message.observed_at - correction
        if rejection := report_rejection(message, age, policy.plausibility, policy.times):
            return rejection
        return rules.Report(message, parcel.received_at - age, parcel.key_id, parcel.witness)

    def _area(self, report: ObservationReport) -> tuple[LatLon, float]:
        """The circle that holds all a report could match: what it saw, the gate, and an obstacle's allowed drift."""
        limits = self._policy.plausibility
        seen_m = max((math.hypot(item.east_m, item.north_m) for item in report.detections), default=0.0)
        reach_m = limits.reach_m if report.inspections else min(seen_m, limits.reach_m)
        return report.origin.position, reach_m + self._policy.gate_m + self._policy.matching.greatest_drift_m

    def _repository(self, connection: AsyncConnection) -> Repository:
        return Repository(connection, self._policy.life)


def _answered_before(parcel: _Parcel, earlier: LoggedReport) -> ReportResult:
    if earlier.body_sha256 != parcel.body_sha256:
        return answers.refused(parcel.message, ReportStatus.REJECTED, "conflict")
    answer = ReportResult.model_validate_json(earlier.answer)
    return answer.model_copy(update={"status": ReportStatus.DUPLICATE})


def _line(parcel: _Parcel, report: rules.Report, result: ReportResult, held: list[tuple[int, int]]) -> LoggedReport:
    return LoggedReport(
        key_id=parcel.key_id,
        report_id=parcel.message.report_id,
        body_sha256=parcel.body_sha256,
        witness=parcel.witness,
        observed_at=report.observed_at,
        received_at=parcel.received_at,
        body=parcel.body,
        answer=result.model_dump_json(),
        tiles=held,
    )


async def _pause(longest_s: float) -> None:
    await asyncio.sleep(random.uniform(0, longest_s))  # noqa: S311  # jitter, not a secret
