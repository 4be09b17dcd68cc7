"""Delivery: every answer is obeyed, the poison report is found, and nothing leaves the outbox unanswered."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from random import Random
from uuid import UUID

import httpx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from contract.observation import MAX_REPORTS, ObservationBatch, ObservationReport, ReportResult, ReportStatus
from tests.unit.vehicle_client.outbox_making import (
    Handler,
    all_accepted,
    answer_of,
    batch_in,
    client_of,
    ids,
    problem,
    reports,
)
from vehicle_client.link.back_off import GREATEST_S
from vehicle_client.link.delivery import DROPPED_IN_ROW, STOPPED_S, Deliverer
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


@pytest.fixture
def outbox(tmp_path: Path) -> Iterator[Outbox]:
    with closing(Outbox(tmp_path / "outbox.sqlite3")) as outbox:
        yield outbox


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


def test_an_empty_outbox_asks_nothing_of_the_server(outbox: Outbox) -> None:
    assert deliverer(outbox, raising(AssertionError)).deliver() == []


@pytest.mark.parametrize("status", ["accepted", "duplicate", "rejected"])
def test_an_answer_for_good_settles_the_report(outbox: Outbox, status: str) -> None:
    (report,) = filled(outbox, 1)
    sender = deliverer(outbox, lambda r: answer_of(batch_in(r), ReportStatus(status)))
    assert [(r.report_id, r.status) for r in sender.deliver()] == [(report.report_id, status)]
    assert (outbox.waiting, outbox.counts) == (0, {status: 1})


def test_what_is_to_be_sent_again_or_was_not_answered_stays_for_later(outbox: Outbox) -> None:
    sent, clock = filled(outbox, 3), Clock()
    server = Server(lambda r: answer_of(batch_in(r), ReportStatus.RETRY, ReportStatus.ACCEPTED))
    sender = deliverer(outbox, server, clock)
    assert [r.report_id for r in sender.deliver()] == [sent[1].report_id]
    assert sender.deliver() == []
    assert server.sizes == [3]
    clock.now_s += sender.wait_s
    server.handler = accepting
    assert {r.report_id for r in sender.deliver()} == {sent[0].report_id, sent[2].report_id}


@pytest.mark.parametrize(
    "error",
    [httpx.ConnectError, httpx.ConnectTimeout, httpx.ReadTimeout, httpx.RemoteProtocolError, httpx.DecodingError],
)
def test_a_network_that_fails_loses_nothing_and_is_asked_ever_more_rarely(
    outbox: Outbox, error: type[Exception]
) -> None:
    clock = Clock()
    filled(outbox, 1)
    sender = deliverer(outbox, raising(error), clock)
    waits = []
    for _ in range(12):
        assert sender.deliver() == []
        waits.append(sender.wait_s)
        clock.now_s += sender.wait_s
    assert 0.5 <= waits[0] <= 1
    assert waits[2] > waits[0]
    assert GREATEST_S / 2 <= waits[-1] <= GREATEST_S
    assert outbox.waiting == 1


def test_until_the_wait_is_over_nobody_is_asked_unless_the_network_comes_back(outbox: Outbox) -> None:
    filled(outbox, 1)
    server = Server(raising(httpx.ConnectError))
    sender = deliverer(outbox, server)
    for _ in range(3):
        sender.deliver()
    assert server.sizes == [1]
    sender.hurry()
    server.handler = accepting
    assert len(sender.deliver()) == 1


def test_a_wait_that_the_server_asked_for_is_kept_also_when_the_network_comes_back(outbox: Outbox) -> None:
    clock = Clock()
    filled(outbox, 1)
    server = Server(saying(problem(429, "too-many-requests", **{"Retry-After": "30"})))
    sender = deliverer(outbox, server, clock)
    sender.deliver()
    assert sender.wait_s >= 30
    sender.hurry()
    sender.deliver()
    assert server.sizes == [1]
    clock.now_s += sender.wait_s
    server.handler = accepting
    assert len(sender.deliver()) == 1


@pytest.mark.parametrize(
    ("response", "said"),
    [
        (problem(401, "unauthenticated"), "401: because of unauthenticated"),
        (httpx.Response(302, headers={"location": "http://login.hotel"}), "302: Found"),
        (httpx.Response(200, html="<html>Welcome</html>"), "not of this contract"),
        (httpx.Response(404, html="<html>"), "404: Not Found"),
    ],
)
def test_a_refusal_is_told_once_costs_nothing_and_is_asked_about_rarely(
    outbox: Outbox, caplog: pytest.LogCaptureFixture, response: httpx.Response, said: str
) -> None:
    clock = Clock()
    filled(outbox, 2)
    server = Server(saying(response))
    sender = deliverer(outbox, server, clock)
    for _ in range(3):
        assert sender.deliver() == []
        assert sender.wait_s >= STOPPED_S
        clock.now_s += sender.wait_s
    assert said in str(sender.refusal)
    assert [record.levelname for record in caplog.records].count("ERROR") == 1
    server.handler = accepting
    assert len(sender.deliver()) == 2
    assert sender.refusal is None


@pytest.mark.parametrize(("status", "kind"), [(422, "invalid"), (400, "bad-request"), (413, "body-too-large")])
@pytest.mark.parametrize("place", [0, 36, 99, 104])
def test_a_poison_report_is_found_dropped_and_counted_and_no_other(
    outbox: Outbox, status: int, kind: str, place: int
) -> None:
    clock = Clock()
    sent = filled(outbox, 105)
    poison = sent[place].report_id
    server = Server(refusing_batches_with(poison, status, kind))
    sender = deliverer(outbox, server, clock)
    results = all_delivered(sender, clock, 40)
    assert outbox.counts == {"accepted": 104, "refused": 1}
    assert [r.report_id for r in results if r.status is ReportStatus.REJECTED] == [poison]
    assert {r.report_id for r in results} == set(ids(sent))
    assert len(server.sizes) < 30


def test_a_report_that_the_server_fails_on_holds_up_no_other(outbox: Outbox) -> None:
    clock = Clock()
    sent = filled(outbox, 10)
    server = Server(refusing_batches_with(sent[0].report_id, 500, "internal"))
    sender = deliverer(outbox, server, clock)
    started_s = clock.now_s
    while outbox.waiting > 1:
        sender.deliver()
        clock.now_s += sender.wait_s if outbox.waiting > 1 else 0
    assert clock.now_s - started_s < 1
    assert sender.wait_s > 1
    # It waits alone, is asked about ever more rarely, and is taken when the server is mended.
    before = len(server.sizes)
    for _ in range(100):
        sender.deliver()
        clock.now_s += 1
    assert 2 <= len(server.sizes) - before <= 12
    server.handler = accepting
    clock.now_s += GREATEST_S
    assert [r.report_id for r in sender.deliver()] == [sent[0].report_id]


def drive_for(sender: Deliverer, clock: Clock, seconds: int) -> None:
    for _ in range(seconds):
        sender.deliver()
        clock.now_s += 1


def test_a_server_that_fails_on_everything_is_not_run_over_and_costs_nothing(outbox: Outbox) -> None:
    clock = Clock()
    filled(outbox, 150)
    server = Server(saying(problem(500, "internal")))
    sender = deliverer(outbox, server, clock)
    drive_for(sender, clock, 3600)
    assert len(server.sizes) < 150
    assert outbox.waiting == 150
    assert "every report is refused: 500" in str(sender.refusal)
    server.handler = accepting
    drive_for(sender, clock, 180)
    assert (outbox.waiting, sender.refusal) == (0, None)


def test_a_server_of_another_version_does_not_empty_the_outbox(outbox: Outbox) -> None:
    clock = Clock()
    filled(outbox, 150)
    server = Server(saying(problem(422, "invalid")))
    sender = deliverer(outbox, server, clock)
    drive_for(sender, clock, 3600)
    assert outbox.counts == {"refused": DROPPED_IN_ROW}
    assert len(server.sizes) < 150
    server.handler = accepting
    drive_for(sender, clock, 180)
    assert outbox.counts == {"refused": DROPPED_IN_ROW, "accepted": 150 - DROPPED_IN_ROW}


def test_many_poison_reports_are_all_dropped_and_hold_up_no_other(outbox: Outbox) -> None:
    clock = Clock()
    sent = filled(outbox, 40)
    poison = set(ids(sent[:12]))

    def taking_none_of_them(request: httpx.Request) -> httpx.Response:
        batch = batch_in(request)
        return problem(422, "invalid") if poison & {r.report_id for r in batch.reports} else all_accepted(batch)

    sender = deliverer(outbox, taking_none_of_them, clock)
    drive_for(sender, clock, 120)
    assert outbox.counts["accepted"] == 28
    # The last ones wait for a server that takes something.
    more = reports(20, first=100)
    for report in more:
        outbox.put(report)
        drive_for(sender, clock, 60)
    assert outbox.counts == {"accepted": 48, "refused": 12}


def test_what_is_too_large_for_a_slow_link_goes_in_smaller_batches(outbox: Outbox) -> None:
    clock = Clock()
    filled(outbox, 64)

    def slow(request: httpx.Request) -> httpx.Response:
        if len(batch_in(request).reports) > 5:
            raise httpx.WriteTimeout("slow")
        return accepting(request)

    server = Server(slow)
    all_delivered(deliverer(outbox, server, clock), clock)
    assert outbox.counts == {"accepted": 64}
    assert server.sizes[:6] == [64, 32, 16, 8, 4, 5]
    # What has once been too much is not tried every second time.
    assert sum(size > 5 for size in server.sizes[5:]) < len(server.sizes[5:]) / 2


def test_an_hour_without_network_costs_nothing_and_little_traffic(outbox: Outbox) -> None:
    clock = Clock()
    server = Server(raising(httpx.ConnectError))
    sender = deliverer(outbox, server, clock)
    put = reports(60)
    for second in range(3600):
        if second % 60 == 0:
            outbox.put(put[second // 60])
        assert sender.deliver() == []
        clock.now_s += 1
    assert outbox.waiting == 60
    assert len(server.sizes) < 130
    server.handler = accepting
    clock.now_s += GREATEST_S
    assert [r.report_id for r in sender.deliver()] == ids(put)


def test_a_server_that_cannot_be_reached_says_nothing_of_how_much_the_link_carries(outbox: Outbox) -> None:
    clock = Clock()
    filled(outbox, 64)
    server = Server(raising(httpx.ConnectTimeout))
    sender = deliverer(outbox, server, clock)
    for _ in range(3):
        sender.deliver()
        clock.now_s += sender.wait_s
    assert server.sizes == [64, 64, 64]


def test_a_long_backlog_goes_in_full_batches_each_with_the_moment_of_sending(outbox: Outbox) -> None:
    filled(outbox, 2 * MAX_REPORTS + 20)
    server = Server(accepting)
    sender = deliverer(outbox, server)
    assert [len(sender.deliver()) for _ in range(4)] == [100, 100, 20, 0]
    moments = [batch.sent_at for batch in server.batches]
    assert moments == sorted(set(moments))


def test_a_clock_that_is_wrong_costs_no_report(outbox: Outbox) -> None:
    clock = Clock()
    filled(outbox, 2)
    rejected = [ReportStatus.REJECTED] * 2
    server = Server(lambda r: answer_of(batch_in(r), *rejected, reason="clock-skew"))
    sender = deliverer(outbox, server, clock)
    assert sender.deliver() == []
    assert "clocks" in str(sender.refusal)
    server.handler = accepting
    clock.now_s += sender.wait_s
    assert len(sender.deliver()) == 2


ANSWERS = st.sampled_from(
    ["accept", "lost answer", "no network", "half", "retry", 408, 429, 500, 503, 401, 404, 422, 413, "html", "garbage"]
)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(answers=st.lists(ANSWERS, max_size=25), counts=st.lists(st.integers(0, 8), min_size=1, max_size=4))
def test_whatever_is_answered_the_server_ends_with_each_report_once_or_it_was_dropped_and_told(
    tmp_path_factory: pytest.TempPathFactory, answers: list[str | int], counts: list[int]
) -> None:
    log: list[UUID] = []

    def take(batch: ObservationBatch, of: int) -> httpx.Response:
        statuses = []
        for report in batch.reports[:of]:
            is_new = report.report_id not in log
            statuses.append(ReportStatus.ACCEPTED if is_new else ReportStatus.DUPLICATE)
            if is_new:
                log.append(report.report_id)
        return answer_of(batch, *statuses, *[ReportStatus.RETRY] * (len(batch.reports) - of))

    def faulty(request: httpx.Request) -> httpx.Response:
        batch = batch_in(request)
        match answers.pop() if answers else "accept":
            case "accept":
                return take(batch, len(batch.reports))
            case "lost answer":
                take(batch, len(batch.reports))
                raise httpx.ReadTimeout("lost")
            case "no network":
                raise httpx.ConnectError("none")
            case "half":
                return take(batch, len(batch.reports) // 2)
            case "retry":
                return take(batch, 0)
            case "html":
                return httpx.Response(200, html="<html>")
            case "garbage":
                raise httpx.RemoteProtocolError("garbage")
            case int(status):
                return problem(status, "some-kind")
        raise AssertionError

    clock, put = Clock(), reports(sum(counts))
    with closing(Outbox(tmp_path_factory.mktemp("outbox") / "outbox.sqlite3")) as outbox:
        sender = deliverer(outbox, faulty, clock)
        results: list[ReportResult] = []
        left = iter(put)
        for count in counts:
            for _ in range(count):
                outbox.put(next(left))
            results += sender.deliver()
        results += all_delivered(sender, clock, 80)
        assert outbox.waiting == 0
        dropped = outbox.counts.get("refused", 0)
    assert len(log) == len(set(log))
    assert sorted(r.report_id for r in results) == sorted(ids(put))
    assert len(put) - dropped <= len(log) <= len(put)
