"""The link: what it tells a drive, and that a drive never waits for the network or hears of a fault too late."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from contract.geometry import LatLon
from contract.observation import MAX_REPORTS, ObservationBatch, ReportResult, ReportStatus
from tests.unit.server.making import detection, message
from tests.unit.vehicle_client.making import PATRAS
from tests.unit.vehicle_client.outbox_making import all_accepted, ids, reports
from vehicle_client.area import Heard
from vehicle_client.link import background
from vehicle_client.link.background import BackgroundLink
from vehicle_client.link.http_asking import UnusableError
from vehicle_client.link.outbox import Outbox, OutboxError
from vehicle_client.link.server_link import WITHHELD, ServerLink
from vehicle_client.privacy.quiet_zones import QuietZone
from vehicle_client.privacy.report_privacy import Privacy

NOBODY = "http://127.0.0.1:9"


class Handler(BaseHTTPRequestHandler):
    """Takes reports, after `wait` has returned; refuses WebSockets."""

    wait: Callable[[], object] = staticmethod(lambda: None)
    batches: list[ObservationBatch]

    def do_GET(self) -> None:
        self.send_error(404)

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["content-length"]))
        batch = ObservationBatch.model_validate_json(body)
        self.batches.append(batch)
        type(self).wait()
        answer = all_accepted(batch).content
        self.send_response(200)
        self.send_header("Content-Length", str(len(answer)))
        self.end_headers()
        self.wfile.write(answer)

    def log_request(self, code: object = "-", size: object = "-") -> None:
        """Nothing on the terminal."""

    def log_error(self, what: str, *_: object) -> None:
        """Nothing on the terminal."""


@contextmanager
def server(wait: Callable[[], object] = lambda: None) -> Iterator[tuple[str, list[ObservationBatch]]]:
    batches: list[ObservationBatch] = []
    kind = type("Own", (Handler,), {"wait": staticmethod(wait), "batches": batches})
    with ThreadingHTTPServer(("127.0.0.1", 0), kind) as running:
        threading.Thread(target=running.serve_forever, daemon=True).start()
        try:
            yield f"http://127.0.0.1:{running.server_port}", batches
        finally:
            running.shutdown()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "outbox.sqlite3"


def waiting_in(path: Path) -> int:
    outbox = Outbox(path)
    waiting = outbox.waiting
    outbox.close()
    return waiting


@pytest.mark.parametrize(
    ("url", "key"),
    [
        ("http://[", None),
        ("http://host:port", None),
        ("ftp://host", None),
        ("", None),
        (NOBODY, "schl\u00fcssel\u2603"),
    ],
)
def test_an_address_or_key_that_cannot_be_used_is_refused_at_once(path: Path, url: str, key: str | None) -> None:
    with pytest.raises(UnusableError, match="cannot be asked"):
        ServerLink(url, key, path)


def test_an_outbox_that_another_link_has_is_refused_at_once(path: Path) -> None:
    with ServerLink(NOBODY, None, path), pytest.raises(OutboxError, match="in use"):
        ServerLink(NOBODY, None, path)


def test_the_status_says_how_it_goes(path: Path) -> None:
    with server() as (url, _), ServerLink(url, None, path) as link:
        for report in reports(2):
            link.put(report)
        before = link.status
        assert (before.way, before.waiting, before.unwritten, before.trouble, before.fates) == ("none", 2, 0, None, {})
        assert len(link.deliver()) == 2
        assert (link.status.waiting, link.status.fates) == (0, {"accepted": 2})


def test_a_server_that_was_never_reached_is_told_with_the_time_and_one_that_was_is_not(path: Path) -> None:
    now_s = [0.0]
    with server() as (url, _):
        port = int(url.rsplit(":", 1)[1])
        with ServerLink(url, None, path, clock=lambda: now_s[0]) as link:
            link.put(reports(1)[0])
            assert link.status.unreached_s is None
            assert link.deliver()
            now_s[0] = 60.0
            assert link.status.unreached_s is None
    with ServerLink(f"http://127.0.0.1:{port}", None, path, clock=lambda: now_s[0]) as link:
        link.put(reports(1)[0])
        assert not link.deliver()
        now_s[0] = 95.0
        assert link.hear(PATRAS) == []
        assert (link.status.unreached_s, link.status.waiting, link.status.trouble) == (35.0, 1, None)


def test_in_a_quiet_zone_nothing_is_said_and_every_report_still_has_a_fate(path: Path) -> None:
    home = Privacy(zones=(QuietZone(PATRAS, 300.0),))
    with server() as (url, batches), ServerLink(url, None, path, privacy=home) as link:
        report = message(detection())
        link.put(report)
        assert link.hear(PATRAS) == []
        assert [(r.report_id, r.status, r.reason) for r in link.deliver()] == [
            (report.report_id, ReportStatus.REJECTED, WITHHELD)
        ]
        assert link.deliver() == []
    assert batches == []
    assert waiting_in(path) == 0


def test_a_drive_goes_on_while_the_server_hangs(path: Path) -> None:
    released = threading.Event()
    with server(released.wait) as (url, batches):
        with BackgroundLink(ServerLink(url, None, path, timeout_s=60.0)) as link:
            sent = reports(3)
            link.put(sent[0])
            while not batches:
                link.hear(PATRAS)
            # The server holds the first batch and answers nobody: whatever is called returns.
            link.put(sent[1])
            link.put(sent[2])
            assert link.hear(PATRAS) == []
            assert link.deliver() == []
            assert link.status.waiting == 3
            assert not released.is_set()
            released.set()
            results: list[ReportResult] = []
            while len(results) < 3:
                results += link.deliver()
        assert {r.report_id for r in results} == set(ids(sent))


def test_what_is_put_last_is_delivered_at_the_end_of_the_drive(path: Path) -> None:
    with server() as (url, batches):
        with BackgroundLink(ServerLink(url, None, path), stop_within_s=60.0) as link:
            for report in reports(2 * MAX_REPORTS):
                link.put(report)
        assert sum(len(batch.reports) for batch in batches) == 2 * MAX_REPORTS
    assert waiting_in(path) == 0


def test_a_drive_ends_also_when_the_server_hangs_and_its_reports_are_kept(
    path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    released = threading.Event()
    with server(released.wait) as (url, batches):
        with BackgroundLink(ServerLink(url, None, path, timeout_s=60.0), stop_within_s=0.3) as link:
            link.put(reports(1)[0])
            while not batches:
                link.hear(PATRAS)
        assert not released.is_set()
        assert waiting_in(path) == 1
        released.set()
    assert "Traceback" not in caplog.text
    assert "in memory" not in caplog.text


class BrokenLink(ServerLink):
    """A link with a fault of its own in one place."""

    def hear(self, position: LatLon) -> list[Heard]:
        raise RuntimeError("a fault that nobody foresaw")


def test_a_fault_in_a_thread_is_told_and_does_not_end_the_rest(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(background, "_AFTER_FAULT_S", 0.01)
    with server() as (url, _), BackgroundLink(BrokenLink(url, None, path)) as link:
        while link.status.trouble is None:
            assert link.hear(PATRAS) == []
        assert "a fault that nobody foresaw" in link.status.trouble
        link.put(reports(1)[0])
        results: list[ReportResult] = []
        while not results:
            results += link.deliver()
    assert "Traceback" in caplog.text
    assert results[0].status is ReportStatus.ACCEPTED
