"""The vehicle's outbox and push channel against the real server, which is also stopped, killed and started again."""

from __future__ import annotations

import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from datetime import UTC, datetime, timedelta
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import httpx
import pytest

from contract.events import Appeared, Removed
from contract.geometry import LatLon
from contract.observation import ObservationReport, ReportStatus
from contract.obstacle import ObstacleCollection
from server.geometry.geodesy import offset_from
from tests.integration.test_server_process import serving
from tests.unit.server.making import HOUR, PATRAS, absent, detection, message
from vehicle_client.area import Reached, Surveyed
from vehicle_client.link.delivery import Deliverer
from vehicle_client.link.outbox import Outbox
from vehicle_client.link.push import PushChannel, PushError
from vehicle_client.link.server_link import ServerLink
from vehicle_client.obstacle_map import ObstacleMap, apply
from vehicle_client.privacy.pseudonym import Pseudonyms
from vehicle_client.privacy.quiet_zones import QuietZone
from vehicle_client.privacy.report_privacy import Privacy

SHORT_S = 1.0
"""Long enough for an answer on loopback, short enough to wait for none."""


@pytest.fixture(autouse=True)
def database(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HEADSUP_DATABASE_URL", f"sqlite+aiosqlite:///{tmp_path}/headsup.sqlite3")


@pytest.fixture
def outbox(tmp_path: Path) -> Iterator[Outbox]:
    with closing(Outbox(tmp_path / "outbox.sqlite3")) as outbox:
        yield outbox


@contextmanager
def connected(url: str, api_key: str | None = None) -> Iterator[PushChannel]:
    with closing(PushChannel(url, api_key, timeout_s=10)) as channel:
        yield channel


def seen(vehicle: str = "ego1", east_m: float = 20.0, hours_ago: float = 2) -> ObservationReport:
    return message(detection(east_m), vehicle=vehicle, at=datetime.now(UTC) - hours_ago * HOUR)


def delivered(outbox: Outbox, client: httpx.Client) -> list[ReportStatus]:
    return [result.status for result in Deliverer(outbox, client).deliver()]


def sent(outbox: Outbox, client: httpx.Client, report: ObservationReport) -> list[ReportStatus]:
    outbox.put(report)
    return delivered(outbox, client)


def sightings_near(client: httpx.Client) -> list[int]:
    where = {"lat": PATRAS.latitude_deg, "lon": PATRAS.longitude_deg, "radius_m": 200}
    features = ObstacleCollection.model_validate_json(client.get("/v1/obstacles", params=where).content).features
    return [feature.properties.sightings for feature in features]


class AnswersLost(httpx.BaseTransport):
    """The real network, except that no answer comes back."""

    def __init__(self) -> None:
        self._network = httpx.HTTPTransport()

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        self._network.handle_request(request).read()
        raise httpx.ReadTimeout("the answer was lost", request=request)

    def close(self) -> None:
        self._network.close()


def test_the_first_exchange_gives_all_that_is_known_and_later_ones_what_others_found(outbox: Outbox) -> None:
    with serving() as (_, client), connected(str(client.base_url)) as channel:
        assert sent(outbox, client, seen("ego1")) == ["accepted"]
        (snapshot,) = channel.exchange(PATRAS)
        assert isinstance(snapshot, Surveyed)
        assert len(snapshot.obstacles) == 1
        assert [type(said) for said in channel.exchange(PATRAS)] == [Reached]
        assert sent(outbox, client, seen("ego2", east_m=-40)) == ["accepted"]
        appeared, moved = channel.exchange(PATRAS)
        assert isinstance(appeared, Appeared)
        assert isinstance(moved, Reached)
        assert appeared.obstacle.id != snapshot.obstacles[0].id


def test_what_another_vehicle_finds_filled_leaves_the_map(outbox: Outbox) -> None:
    with serving() as (_, client), connected(str(client.base_url)) as channel:
        sent(outbox, client, seen())
        known = ObstacleMap()
        for said in channel.exchange(PATRAS):
            known = apply(known, said, 0.0)
        (obstacle_id,) = known.obstacles
        look = message(inspections=(absent(obstacle_id),), at=datetime.now(UTC) - HOUR)
        assert sent(outbox, client, look) == ["accepted"]
        messages = channel.exchange(PATRAS)
        assert any(isinstance(said, Removed) for said in messages)
        for said in messages:
            known = apply(known, said, 1.0)
        assert not known.obstacles


def test_a_killed_server_costs_nothing_but_time(outbox: Outbox) -> None:
    with serving() as (process, client):
        url, port = str(client.base_url), client.base_url.port
        with connected(url) as channel:
            assert sent(outbox, client, seen("ego1")) == ["accepted"]
            channel.exchange(PATRAS)
            process.send_signal(signal.SIGKILL)
            process.wait()
            with pytest.raises(PushError):
                channel.exchange(PATRAS)
        assert sent(outbox, client, seen("ego2")) == []
        assert outbox.waiting == 1
        with pytest.raises(PushError, match="no push channel"):
            PushChannel(url, None, timeout_s=SHORT_S)
    with serving("--port", str(port)) as (_, client):
        assert str(client.base_url) == url
        assert delivered(outbox, client) == ["accepted"]
        assert delivered(outbox, client) == []
        assert sightings_near(client) == [2]
        with connected(url) as channel:
            (snapshot,) = channel.exchange(PATRAS)
            assert isinstance(snapshot, Surveyed)
            assert [feature.properties.sightings for feature in snapshot.obstacles] == [2]


def test_a_report_whose_answer_was_lost_counts_once(outbox: Outbox) -> None:
    with serving() as (_, client):
        with httpx.Client(transport=AnswersLost(), base_url=client.base_url) as unlucky:
            assert sent(outbox, unlucky, seen()) == []
        assert sightings_near(client) == [1]
        assert delivered(outbox, client) == ["duplicate"]
        assert outbox.waiting == 0
        assert sightings_near(client) == [1]


def test_a_server_that_stands_still_is_given_up_at_the_timeout(outbox: Outbox) -> None:
    with serving() as (process, client):
        with closing(PushChannel(str(client.base_url), None, timeout_s=SHORT_S)) as channel:
            channel.exchange(PATRAS)
            process.send_signal(signal.SIGSTOP)
            with pytest.raises(PushError, match="not acknowledged"):
                channel.exchange(PATRAS)
            with httpx.Client(base_url=client.base_url, timeout=SHORT_S) as impatient:
                assert sent(outbox, impatient, seen()) == []
            process.send_signal(signal.SIGCONT)
        assert delivered(outbox, client) in (["accepted"], ["duplicate"])
        assert sightings_near(client) == [1]


def test_a_wrong_key_is_refused_by_both_ways_and_the_report_stays(
    outbox: Outbox, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HEADSUP_BOOTSTRAP_OPERATOR_KEY", "the-operator's-key-of-the-tests-0123456789")
    with serving() as (_, client):
        url = str(client.base_url)
        with pytest.raises(PushError, match="401"):
            PushChannel(url, "wrong")
        outbox.put(seen())
        sender = Deliverer(outbox, client)
        assert sender.deliver() == []
        assert "401" in str(sender.refusal)
        assert outbox.waiting == 1
        with connected(url, "the-operator's-key-of-the-tests-0123456789") as channel:
            assert [type(said) for said in channel.exchange(PATRAS)] == [Surveyed]


@pytest.mark.parametrize("url", ["http://127.0.0.1:{port}", "http://", "nonsense", "ftp://127.0.0.1:{port}"])
def test_no_server_at_the_address_is_said(url: str) -> None:
    with closing(socket.socket()) as unused:
        # Bound and not listening: nobody else takes the port, and nobody answers there.
        unused.bind(("127.0.0.1", 0))
        with pytest.raises(PushError):
            PushChannel(url.format(port=unused.getsockname()[1]), None, timeout_s=SHORT_S)


class NoSockets(BaseHTTPRequestHandler):
    """A proxy that knows nothing of WebSockets, in front of `server`."""

    server_url: str
    asked: list[tuple[str, int]]

    def do_GET(self) -> None:
        if "upgrade" in self.headers:
            self.send_error(501)
            return
        names = ("if-none-match", "accept")
        headers = {name: value for name in names if (value := self.headers.get(name))}
        answer = httpx.get(f"{self.server_url}{self.path}", headers=headers)
        self.asked.append((self.path, answer.status_code))
        self.send_response(answer.status_code)
        self.send_header("ETag", answer.headers["etag"])
        self.send_header("Content-Length", str(len(answer.content)))
        self.end_headers()
        self.wfile.write(answer.content)

    def log_request(self, code: object = "-", size: object = "-") -> None:
        """Nothing on the terminal."""

    def log_error(self, what: str, *_: object) -> None:
        """Nothing on the terminal."""


@contextmanager
def behind_a_proxy_without_sockets(server_url: str) -> Iterator[tuple[str, list[tuple[str, int]]]]:
    asked: list[tuple[str, int]] = []
    kind = type("Proxy", (NoSockets,), {"server_url": server_url, "asked": asked})
    with ThreadingHTTPServer(("127.0.0.1", 0), kind) as proxy:
        threading.Thread(target=proxy.serve_forever, daemon=True).start()
        try:
            yield f"http://127.0.0.1:{proxy.server_port}", asked
        finally:
            proxy.shutdown()


def east_of_patras(east_m: float) -> LatLon:
    return offset_from(PATRAS, east_m, 0.0)


def test_where_no_socket_passes_the_map_is_the_same(outbox: Outbox, tmp_path: Path) -> None:
    clock_s = [0.0]
    with serving() as (_, client), behind_a_proxy_without_sockets(str(client.base_url)) as (url, asked):
        sent(outbox, client, seen("ego1", east_m=80.0))
        sent(outbox, client, seen("ego1", east_m=-80.0))
        with ServerLink(url, None, tmp_path / "link.sqlite3", clock=lambda: clock_s[0]) as link:
            known = ObstacleMap()
            for step in range(60):
                clock_s[0] += 1.0
                here = east_of_patras(-600.0 + 10 * step)
                for said in link.hear(here):
                    known = apply(known, said, clock_s[0])
            assert link.status.way == "polling"
        by_push = ObstacleMap()
        with connected(str(client.base_url)) as channel:
            for said in channel.exchange(PATRAS):
                by_push = apply(by_push, said, clock_s[0])
    assert {i: entry.feature for i, entry in known.obstacles.items()} == {
        i: entry.feature for i, entry in by_push.obstacles.items()
    }
    assert len(by_push.obstacles) == 2
    assert {status for _, status in asked} == {200, 304}
    assert any("heading_deg=90&corridor_m=500" in path for path, _ in asked)


def test_the_server_takes_what_leaves_a_private_car(outbox: Outbox, tmp_path: Path) -> None:
    privacy = Privacy(zones=(QuietZone(east_of_patras(-1_000), 300.0),), pseudonyms=Pseudonyms())
    with (
        serving() as (_, client),
        ServerLink(str(client.base_url), None, tmp_path / "l.sqlite3", privacy=privacy) as link,
    ):
        (snapshot,) = link.hear(PATRAS)
        assert isinstance(snapshot, Surveyed)
        # Two cars' lengths apart at once: coarse origins must not look like two vehicles.
        for number in range(40):
            at = datetime.now(UTC) - HOUR + number * timedelta(milliseconds=100)
            link.put(message(detection(20.0 - number, 3), at=at, number=number, position=east_of_patras(float(number))))
        results = link.deliver()
        assert [result.status for result in results] == ["accepted"] * 40
        assert sightings_near(client) == [1]
