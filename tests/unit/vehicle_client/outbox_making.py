"""Reports, and servers that answer as they are told, for the tests of the outbox and of delivery."""

from __future__ import annotations

from collections.abc import Callable
from datetime import timedelta
from uuid import UUID

import httpx

from contract.observation import (
    Inspection,
    ObservationBatch,
    ObservationBatchResult,
    ObservationReport,
    Outcome,
    ReportResult,
    ReportStatus,
)
from tests.unit.server.making import NOON, detection, message
from vehicle_client.link.outbox import Outbox

Handler = Callable[[httpx.Request], httpx.Response]


def reports(count: int, *, first: int = 0) -> list[ObservationReport]:
    """Reports with a detection each."""
    return [message(detection(), at=NOON + timedelta(seconds=n), number=n) for n in range(first, first + count)]


def look(number: int) -> ObservationReport:
    """A report that has an inspection only."""
    seen = Inspection(obstacle_id=UUID(int=1), outcome=Outcome.PRESENT, visible_fraction=1.0)
    return message(inspections=(seen,), at=NOON + timedelta(seconds=number), number=number)


def ids(items: list[ObservationReport]) -> list[UUID]:
    return [item.report_id for item in items]


def client_of(handler: Handler) -> httpx.Client:
    return httpx.Client(transport=httpx.MockTransport(handler), base_url="http://headsup")


def batch_in(request: httpx.Request) -> ObservationBatch:
    return ObservationBatch.model_validate_json(request.content)


def answer_of(batch: ObservationBatch, *statuses: ReportStatus, reason: str | None = None) -> httpx.Response:
    """The reports of a batch answered with these statuses, in turn; the rest not at all."""
    pairs = zip(batch.reports, statuses, strict=False)
    results = tuple(ReportResult(report_id=r.report_id, status=status, reason=reason) for r, status in pairs)
    return httpx.Response(200, content=ObservationBatchResult(results=results).model_dump_json())


def all_accepted(batch: ObservationBatch) -> httpx.Response:
    return answer_of(batch, *[ReportStatus.ACCEPTED] * len(batch.reports))


def problem(status: int, kind: str, **headers: str) -> httpx.Response:
    """A problem as the server words it."""
    body = {"type": f"urn:headsup:problem:{kind}", "title": "T", "status": status, "detail": f"because of {kind}"}
    return httpx.Response(status, json=body, headers=headers)


def answered(*items: ObservationReport, status: str = "accepted", reason: str | None = None) -> list[ReportResult]:
    return [ReportResult(report_id=i.report_id, status=ReportStatus(status), reason=reason) for i in items]


def waiting_in(outbox: Outbox, most: int = 10_000) -> list[UUID]:
    return [kept.report_id for kept in outbox.batch(most)]
