"""The vehicle's outbox and push channel against the real server, which is also stopped, killed and started again."""

from __future__ import annotations

import signal
import socket
from collections.abc import Iterator
from contextlib import closing, contextmanager
from datetime import UTC, datetime
from pathlib import Path

import httpx
import pytest

from contract.events import Appeared, Removed
from contract.observation import ObservationReport, ReportStatus
from contract.obstacle import ObstacleCollection
from tests.integration.test_server_process import serving
from tests.unit.server.making import HOUR, PATRAS, absent, detection, message
from vehicle_client.area import Reached, Surveyed
from vehicle_client.delivery import Deliverer
from vehicle_client.obstacle_map import ObstacleMap, apply
from vehicle_client.outbox import Outbox
from vehicle_client.push import PushChannel, PushError

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
