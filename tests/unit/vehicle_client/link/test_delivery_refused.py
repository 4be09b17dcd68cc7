"""Delivery to a server that refuses: what it takes is delivered, the poison report is found, nobody is run over."""

from __future__ import annotations

import httpx
import pytest

from contract.observation import ReportStatus
from tests.unit.vehicle_client.delivery_making import (
    Clock,
    Server,
    accepting,
    all_delivered,
    deliverer,
    filled,
    refusing_batches_with,
    saying,
)
from tests.unit.vehicle_client.outbox_making import (
    all_accepted,
    batch_in,
    ids,
    problem,
    reports,
)
from vehicle_client.link.back_off import GREATEST_S
from vehicle_client.link.delivery import DROPPED_IN_ROW, STOPPED_S, Deliverer
from vehicle_client.link.outbox import Outbox


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
