"""Polling: the obstacles around or ahead, as the server answers them in pages and by entity tag."""

from __future__ import annotations

import math
from collections.abc import Callable

import httpx
import pytest

from contract.obstacle import Link, ObstacleCollection
from tests.unit.vehicle_client.making import PATRAS, feature
from vehicle_client.area import Area, Strip
from vehicle_client.link.http_asking import MAX_ANSWER_BYTES
from vehicle_client.link.polling import AHEAD_RADIUS_M, CORRIDOR_M, MOST_PAGES, Poller, PollError
from vehicle_client.link.push import AREA_RADIUS_M

Handler = Callable[[httpx.Request], httpx.Response]


def poller(handler: Handler) -> Poller:
    return Poller(httpx.Client(transport=httpx.MockTransport(handler), base_url="http://headsup"))


def page(*numbers: int, following: str | None = None, tag: str = 'W/"a"') -> httpx.Response:
    links = () if following is None else (Link(rel="next", href=following),)
    features = tuple(feature(n, east_m=float(n)) for n in numbers)
    body = ObstacleCollection(features=features, links=links).model_dump_json()
    return httpx.Response(200, content=body, headers={"ETag": tag})


def test_a_car_that_stands_asks_for_the_circle_around_it() -> None:
    asked = []

    def answer(request: httpx.Request) -> httpx.Response:
        asked.append(dict(request.url.params))
        return page(1, 2)

    surveyed = poller(answer).poll(PATRAS)
    assert asked == [{"lat": "38.2466", "lon": "21.7346", "radius_m": "600"}]
    assert surveyed.area == Area(PATRAS, AREA_RADIUS_M)
    assert [o.id.int for o in surveyed.obstacles] == [1, 2]


def test_a_car_that_drives_asks_for_the_road_ahead() -> None:
    asked = []

    def answer(request: httpx.Request) -> httpx.Response:
        asked.append(dict(request.url.params))
        return page()

    surveyed = poller(answer).poll(PATRAS, math.radians(89.7))
    assert asked == [{"lat": "38.2466", "lon": "21.7346", "radius_m": "1000", "heading_deg": "90", "corridor_m": "500"}]
    assert surveyed.area == Area(PATRAS, AHEAD_RADIUS_M, Strip(math.pi / 2, CORRIDOR_M))


def test_while_nothing_changes_nothing_is_sent_again() -> None:
    tags = []

    def answer(request: httpx.Request) -> httpx.Response:
        tags.append(request.headers.get("if-none-match"))
        return httpx.Response(304) if tags[-1] == 'W/"a"' else page(1)

    asking = poller(answer)
    assert [[o.id.int for o in asking.poll(PATRAS).obstacles] for _ in range(3)] == [[1]] * 3
    assert tags == [None, 'W/"a"', 'W/"a"']


def test_pages_are_followed_to_the_last() -> None:
    def answer(request: httpx.Request) -> httpx.Response:
        cursor = int(request.url.params.get("cursor", "0"))
        return page(cursor, following=f"/v1/obstacles?cursor={cursor + 1}" if cursor < 3 else None)

    surveyed = poller(answer).poll(PATRAS)
    assert [o.id.int for o in surveyed.obstacles] == [0, 1, 2, 3]
    assert surveyed.area.radius_m == AREA_RADIUS_M


def test_pages_without_end_are_cut_off_and_no_more_is_claimed_than_was_heard() -> None:
    cursors = []

    def answer(request: httpx.Request) -> httpx.Response:
        cursors.append(int(request.url.params.get("cursor", "0")))
        assert "if-none-match" not in request.headers
        return page(10 * cursors[-1], following=f"/v1/obstacles?cursor={cursors[-1] + 1}")

    asking = poller(answer)
    surveyed = asking.poll(PATRAS)
    assert cursors == list(range(MOST_PAGES))
    assert surveyed.area.radius_m == pytest.approx(10 * (MOST_PAGES - 1), abs=0.1)
    asking.poll(PATRAS)


@pytest.mark.parametrize(
    "following", ["http://elsewhere/v1/obstacles?cursor=1", "//elsewhere/v1/obstacles?x", "/v1/keys", "", "ftp://x"]
)
def test_a_next_page_elsewhere_is_not_asked_for_since_the_key_would_go_there(following: str) -> None:
    hosts = []

    def answer(request: httpx.Request) -> httpx.Response:
        hosts.append(request.url.host)
        return page(1, following=following)

    with pytest.raises(PollError, match="outside"):
        poller(answer).poll(PATRAS)
    assert hosts == ["headsup"]


@pytest.mark.parametrize("status", [401, 403, 404, 429, 500, 503, 302, 204])
def test_a_refusal_is_said_with_its_status(status: int) -> None:
    with pytest.raises(PollError, match=str(status)) as refused:
        poller(lambda _: httpx.Response(status)).poll(PATRAS)
    assert refused.value.status == status


@pytest.mark.parametrize("content", [b"", b"<html>", b'{"type": "FeatureCollection"}', b"\xff", b"[]"])
def test_an_answer_of_another_contract_is_an_error(content: bytes) -> None:
    with pytest.raises(PollError, match="contract"):
        poller(lambda _: httpx.Response(200, content=content)).poll(PATRAS)


def test_a_304_that_nobody_asked_for_is_an_error() -> None:
    with pytest.raises(PollError):
        poller(lambda _: httpx.Response(304)).poll(PATRAS)


def test_an_answer_without_end_is_cut_off() -> None:
    sent = []

    def endless() -> object:
        while True:
            sent.append(1)
            yield b" " * (1 << 20)

    with pytest.raises(PollError, match="exceeds"):
        poller(lambda _: httpx.Response(200, content=endless())).poll(PATRAS)  # type: ignore[arg-type]
    assert len(sent) <= MAX_ANSWER_BYTES / (1 << 20) + 2


def test_a_network_that_fails_is_an_error_of_polling() -> None:
    def fail(_: httpx.Request) -> httpx.Response:
        raise httpx.ConnectError("none")

    with pytest.raises(PollError, match="no answer"):
        poller(fail).poll(PATRAS)
