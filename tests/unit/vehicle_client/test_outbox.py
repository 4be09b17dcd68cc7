"""The outbox: what the car wants to say survives everything until the server has answered it."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from datetime import timedelta
from pathlib import Path

import httpx
import pytest

from contract.observation import (
    MAX_BODY_BYTES,
    MAX_REPORTS,
    ObservationBatch,
    ObservationBatchResult,
    ObservationReport,
    ReportResult,
    ReportStatus,
)
from tests.unit.server.making import NOON, detection, message
from vehicle_client.outbox import RETRIED, Outbox, OutboxError, deliver

Handler = Callable[[httpx.Request], httpx.Response]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "outbox.sqlite3"


@pytest.fixture
def outbox(path: Path) -> Iterator[Outbox]:
    outbox = Outbox(path)
    yield outbox
    outbox.close()


def reports(count: int) -> list[ObservationReport]:
    return [message(detection(), at=NOON + timedelta(seconds=n), number=n) for n in range(count)]


def client_of(handler: Handler) -> httpx.Client:
    return httpx.Client(transport=httpx.MockTransport(handler), base_url="http://headsup")


def batch_in(request: httpx.Request) -> ObservationBatch:
    return ObservationBatch.model_validate_json(request.content)


def answering(*statuses: ReportStatus) -> Handler:
    """A server that answers the reports of a batch with these statuses, in turn; the rest not at all."""

    def handle(request: httpx.Request) -> httpx.Response:
        pairs = zip(batch_in(request).reports, statuses, strict=False)
        results = tuple(ReportResult(report_id=report.report_id, status=status) for report, status in pairs)
        return httpx.Response(200, content=ObservationBatchResult(results=results).model_dump_json())

    return handle


def raising(error: type[Exception]) -> Handler:
    def handle(_request: httpx.Request) -> httpx.Response:
        raise error("the network")

    return handle


def test_what_was_put_is_there_after_reopening_oldest_first(path: Path) -> None:
    sent = reports(5)
    first = Outbox(path)
    for report in reversed(sent):
        first.put(report)
    first.close()
    second = Outbox(path)
    assert second.pending() == list(reversed(sent))
    second.settle([sent[4].report_id, sent[0].report_id])
    second.close()
    third = Outbox(path)
    assert third.pending() == [sent[3], sent[2], sent[1]]
    third.close()


def test_a_report_survives_a_process_that_is_killed_right_after_putting_it(path: Path) -> None:
    report = reports(1)[0]
    program = (
        "import os, sys; from contract.observation import ObservationReport; from vehicle_client.outbox import Outbox;"
        "Outbox(sys.argv[1]).put(ObservationReport.model_validate_json(sys.stdin.read())); os._exit(9)"
    )
    ended = subprocess.run([sys.executable, "-c", program, str(path)], input=report.model_dump_json().encode())
    assert ended.returncode == 9
    outbox = Outbox(path)
    assert outbox.pending() == [report]
    outbox.close()


def test_the_same_report_is_kept_once_and_in_its_place(outbox: Outbox) -> None:
    one, other = reports(2)
    for report in (one, other, one):
        outbox.put(report)
    assert outbox.pending() == [one, other]


def test_settling_what_is_not_there_does_nothing(outbox: Outbox) -> None:
    one, other = reports(2)
    outbox.put(one)
    outbox.settle([other.report_id])
    assert outbox.pending() == [one]


def test_a_file_that_is_no_database_is_refused_and_left_as_it_is(path: Path) -> None:
    path.write_bytes(b"something else, not a database at all" * 100)
    with pytest.raises(OutboxError, match="move it away"):
        Outbox(path)
    assert path.read_bytes().startswith(b"something else")


def test_an_empty_outbox_asks_nothing_of_the_server(outbox: Outbox) -> None:
    with client_of(raising(httpx.ConnectError)) as client:
        assert deliver(outbox, client) == []


@pytest.mark.parametrize("status", [ReportStatus.ACCEPTED, ReportStatus.DUPLICATE, ReportStatus.REJECTED])
def test_an_answer_for_good_settles_the_report(outbox: Outbox, status: ReportStatus) -> None:
    (report,) = reports(1)
    outbox.put(report)
    with client_of(answering(status)) as client:
        assert [(r.report_id, r.status) for r in deliver(outbox, client)] == [(report.report_id, status)]
    assert outbox.pending() == []


def test_what_is_to_be_sent_again_or_was_not_answered_stays(outbox: Outbox) -> None:
    sent = reports(3)
    for report in sent:
        outbox.put(report)
    with client_of(answering(ReportStatus.RETRY, ReportStatus.ACCEPTED)) as client:
        assert [r.report_id for r in deliver(outbox, client)] == [sent[1].report_id]
    assert outbox.pending() == [sent[0], sent[2]]


@pytest.mark.parametrize("status", sorted(RETRIED))
def test_a_server_in_trouble_is_asked_again_with_the_same_report(outbox: Outbox, status: int) -> None:
    (report,) = reports(1)
    outbox.put(report)
    with client_of(lambda _: httpx.Response(status)) as client:
        assert deliver(outbox, client) == []
    bodies = []

    def remember(request: httpx.Request) -> httpx.Response:
        bodies.append(batch_in(request))
        return answering(ReportStatus.ACCEPTED)(request)

    with client_of(remember) as client:
        assert len(deliver(outbox, client)) == 1
    assert [batch.reports for batch in bodies] == [(report,)]


@pytest.mark.parametrize(
    "error",
    [httpx.ConnectError, httpx.ConnectTimeout, httpx.ReadTimeout, httpx.RemoteProtocolError, httpx.DecodingError],
)
def test_a_network_that_fails_loses_nothing(outbox: Outbox, error: type[Exception]) -> None:
    (report,) = reports(1)
    outbox.put(report)
    with client_of(raising(error)) as client:
        assert deliver(outbox, client) == []
    assert outbox.pending() == [report]


@pytest.mark.parametrize(
    ("status", "body", "said"),
    [
        (401, {"title": "Unauthorized", "detail": "no such key"}, "401: no such key"),
        (422, {"title": "Unprocessable Content", "detail": "reports.0: bad"}, "422: reports.0: bad"),
        (403, {"title": "Forbidden"}, "403: Forbidden"),
        (404, "<html>", "404: Not Found"),
        (418, ["a", "list"], "418: I'm a teapot"),
        (302, "", "302: Found"),
    ],
)
def test_a_refusal_is_said_and_loses_nothing(outbox: Outbox, status: int, body: object, said: str) -> None:
    (report,) = reports(1)
    outbox.put(report)
    content = body if isinstance(body, str) else json.dumps(body)
    with client_of(lambda _: httpx.Response(status, content=content)) as client, pytest.raises(OutboxError) as refused:
        deliver(outbox, client)
    assert said in str(refused.value)
    assert outbox.pending() == [report]


@pytest.mark.parametrize("content", [b"", b"OK", b"{}", b'{"results": [{"report_id": 1}]}', b"\xff"])
def test_an_answer_of_another_contract_is_said_and_loses_nothing(outbox: Outbox, content: bytes) -> None:
    (report,) = reports(1)
    outbox.put(report)
    with client_of(lambda _: httpx.Response(200, content=content)) as client, pytest.raises(OutboxError):
        deliver(outbox, client)
    assert outbox.pending() == [report]


def test_many_reports_go_in_batches_that_the_server_takes_oldest_first(outbox: Outbox) -> None:
    sent = reports(MAX_REPORTS + 20)
    for report in sent:
        outbox.put(report)
    with client_of(answering(*[ReportStatus.ACCEPTED] * MAX_REPORTS)) as client:
        counts = [len(deliver(outbox, client)) for _ in range(3)]
    assert counts == [MAX_REPORTS, 20, 0]


def test_a_long_time_offline_never_makes_a_body_that_the_server_refuses(outbox: Outbox) -> None:
    points = tuple((n % 100 - 50, n // 100, -n % 30) for n in range(512))
    rich = detection().model_copy(update={"points_cm": points})
    sent = [message(*[rich] * 10, at=NOON + timedelta(seconds=n), number=n) for n in range(40)]
    for report in sent:
        outbox.put(report)
    sizes, delivered = [], []

    def measure(request: httpx.Request) -> httpx.Response:
        sizes.append(len(request.content))
        return answering(*[ReportStatus.ACCEPTED] * MAX_REPORTS)(request)

    with client_of(measure) as client:
        while answered := deliver(outbox, client):
            delivered += [result.report_id for result in answered]
    assert delivered == [report.report_id for report in sent]
    assert max(sizes) <= MAX_BODY_BYTES
    assert max(sizes) > MAX_BODY_BYTES / 2
