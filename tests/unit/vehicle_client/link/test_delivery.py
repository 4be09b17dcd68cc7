"""Delivery: every answer is obeyed, the poison report is found, and nothing leaves the outbox unanswered."""

from __future__ import annotations

from contextlib import closing
from uuid import UUID

import httpx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from contract.observation import MAX_REPORTS, ObservationBatch, ReportResult, ReportStatus
from tests.unit.vehicle_client.delivery_making import (
    Clock,
    Server,
    accepting,
    all_delivered,
    deliverer,
    filled,
    raising,
    saying,
)
from tests.unit.vehicle_client.outbox_making import (
    answer_of,
    batch_in,
    ids,
    problem,
    reports,
)
from vehicle_client.link.back_off import GREATEST_S
from vehicle_client.link.outbox import Outbox


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
