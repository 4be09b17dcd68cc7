"""A clock, a server and a deliverer for the tests of delivery."""

from __future__ import annotations

from random import Random
from uuid import UUID

import httpx

from contract.observation import ObservationBatch, ObservationReport, ReportResult
from tests.unit.vehicle_client.outbox_making import (
    Handler,
    all_accepted,
    batch_in,
    client_of,
    problem,
    reports,
)
from vehicle_client.link.delivery import Deliverer
from vehicle_client.link.outbox import Outbox


class Clock:
    """A clock that goes when it is told to."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


class Server:
    """Answers as a handler says, and remembers the batches."""

    def __init__(self, handler: Handler) -> None:
        self.handler = handler
        self.batches: list[ObservationBatch] = []

    def __call__(self, request: httpx.Request) -> httpx.Response:
        self.batches.append(batch_in(request))
        return self.handler(request)

    @property
    def sizes(self) -> list[int]:
        return [len(batch.reports) for batch in self.batches]


def filled(outbox: Outbox, count: int) -> list[ObservationReport]:
    sent = reports(count)
    for report in sent:
        outbox.put(report)
    return sent


def deliverer(outbox: Outbox, server: Handler, clock: Clock | None = None) -> Deliverer:
    return Deliverer(outbox, client_of(server), jitter=Random(1), clock=clock or Clock())  # noqa: S311


def accepting(request: httpx.Request) -> httpx.Response:
    return all_accepted(batch_in(request))


def raising(error: type[Exception]) -> Handler:
    def handle(_request: httpx.Request) -> httpx.Response:
        raise error("the network")

    return handle


def saying(response: httpx.Response) -> Handler:
    return lambda _: httpx.Response(response.status_code, content=response.content, headers=response.headers)


def refusing_batches_with(poison: UUID, status: int, kind: str) -> Handler:
    def handle(request: httpx.Request) -> httpx.Response:
        batch = batch_in(request)
        if poison in [report.report_id for report in batch.reports]:
            return problem(status, kind)
        return all_accepted(batch)

    return handle


def all_delivered(sender: Deliverer, clock: Clock, most_calls: int = 60) -> list[ReportResult]:
    results: list[ReportResult] = []
    for _ in range(most_calls):
        results += sender.deliver()
        clock.now_s += sender.wait_s
    return results
