"""What the service does: takes reports, answers what is near."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Container, Sequence
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from uuid import UUID

from contract.geometry import LatLon
from contract.observation import ObservationBatch, ObservationBatchResult, ReportStatus
from contract.obstacle import ObstacleFeature
from server.errors import ObstacleNotFoundError, UnavailableError
from server.geometry.geodesy import distance_m
from server.ingesting.group import Outcomes, decide_together
from server.ingesting.ingest import Ingest
from server.ingesting.parcel import Parcel
from server.life.policy import Policy
from server.storage.database import Database
from server.storage.features import ObstacleEvent, feature_of
from server.storage.repository import Repository
from server.trust.keys import Caller, witness_name


class Service:
    """The obstacle service on one database. `publish` is called with every event, after its commit.

    `distrusted` names the witnesses whose reports are logged only.
    """

    def __init__(
        self,
        database: Database,
        policy: Policy,
        secret: str,
        write_deadline_s: float,
        publish: Callable[[ObstacleEvent], None],
        distrusted: Callable[[], Container[str]] = frozenset,
    ) -> None:
        self._database = database
        self._policy = policy
        self._secret = secret
        self._distrusted = distrusted
        self.ingest = Ingest(self._decide, write_deadline_s, publish)

    @asynccontextmanager
    async def running(self) -> AsyncIterator[None]:
        """Takes reports within the block; requests end before it does."""
        worker = asyncio.create_task(self.ingest.run())
        try:
            yield
        finally:
            worker.cancel()
            await asyncio.gather(worker, return_exceptions=True)

    async def observe(self, caller: Caller, batch: ObservationBatch) -> ObservationBatchResult:
        """Take the reports of a batch in order; they share transactions with each other and with other batches.

        Raises `UnavailableError` when the database took none of them in time.
        """
        caller.must_be_able_to_post()
        received_at = datetime.now(UTC)
        witnesses = {
            pseudonym: witness_name(caller, pseudonym, self._secret)
            for pseudonym in {report.pseudonym for report in batch.reports}
        }
        parcels = [
            Parcel(
                message=report,
                sent_at=batch.sent_at,
                received_at=received_at,
                key_id=caller.key_id,
                witness=witnesses[report.pseudonym],
                body=report.model_dump_json(),
            )
            for report in batch.reports
        ]
        results = await self.ingest.take(parcels)
        if all(result.status is ReportStatus.RETRY for result in results):
            raise UnavailableError("the database did not take the reports in time; send them again")
        return ObservationBatchResult(results=tuple(results))

    async def near(self, centre: LatLon, radius_m: float, limit: int | None = None) -> tuple[ObstacleFeature, ...]:
        """Live obstacles within `radius_m` (geodesic) of a place, nearest first."""
        async with self._database.read() as connection:
            found = await Repository(connection, self._policy.life).near(centre, radius_m, datetime.now(UTC))
        by_distance = sorted((distance_m(item.position, centre), index) for index, item in enumerate(found))
        return tuple(found[index] for apart_m, index in by_distance if apart_m <= radius_m)[:limit]

    async def obstacle(self, identifier: UUID) -> ObstacleFeature:
        """One obstacle, also a removed one."""
        async with self._database.read() as connection:
            found = await Repository(connection, self._policy.life).obstacle(identifier)
        if found is None:
            raise ObstacleNotFoundError(f"there is no obstacle {identifier}")
        return feature_of(found, self._policy.life)

    async def _decide(self, parcels: Sequence[Parcel]) -> Outcomes:
        return await decide_together(self._database, parcels, self._policy, self._distrusted())
