"""Answers that a client may keep."""

from __future__ import annotations

import gzip

import pytest
from fastapi import Request

from contract.obstacle import Link
from server.reading.representation import answer, holds, next_link

LONG = b'{"features":[' + b"1," * 2_000 + b"1]}"


def request(query: str = "", **headers: str) -> Request:
    raw = [(name.replace("_", "-").encode(), value.encode()) for name, value in headers.items()]
    scope = {"type": "http", "method": "GET", "path": "/v1/x", "query_string": query.encode(), "headers": raw}
    return Request(scope)


@pytest.mark.parametrize("header", ['"a"', 'W/"a"', '"b", W/"a"', '"b","a"', "*", " * "])
def test_a_tag_is_found_among_those_a_client_holds(header: str) -> None:
    assert holds(header, 'W/"a"')


@pytest.mark.parametrize("header", ["", "a", '"b"', 'W/"b", "c"', '"a', "W/", '"aa"'])
def test_another_tag_is_not(header: str) -> None:
    assert not holds(header, 'W/"a"')


def test_what_is_current_is_told_so_without_a_body() -> None:
    response = answer(request(if_none_match='"a"'), LONG, "application/json", '"a"')
    assert (response.status_code, response.body, response.headers["etag"]) == (304, b"", '"a"')


@pytest.mark.parametrize(
    ("accepted", "is_compressed"),
    [
        ("gzip", True),
        ("br, GZIP;q=0.5", True),
        ("gzip;q=0", False),
        ("gzip; q=0.00", False),
        ("br,\tgzip", True),
        ("gzip;\tq=0", False),
        ("identity", False),
    ],
)
def test_gzip_is_sent_to_whoever_takes_it(accepted: str, is_compressed: bool) -> None:
    response = answer(request(accept_encoding=accepted), LONG, "application/json", 'W/"a"')
    body = bytes(response.body)
    assert (response.headers.get("content-encoding") == "gzip") is is_compressed
    assert (gzip.decompress(body) if is_compressed else body) == LONG


def test_short_answers_and_strong_tags_stay_as_they_are() -> None:
    taker = request(accept_encoding="gzip")
    assert answer(taker, b"{}", "application/json", 'W/"a"').body == b"{}"
    assert answer(taker, LONG, "application/json", '"a"').body == LONG


def test_the_next_page_is_the_same_request_with_another_cursor() -> None:
    link = next_link(
        request("kind=bump&kind=pothole&cursor=old&seen_since=2026-01-01T00%3A00%3A00%2B02%3A00"), "new", "t/t"
    )
    assert link == Link(
        rel="next",
        href="/v1/x?kind=bump&kind=pothole&seen_since=2026-01-01T00%3A00%3A00%2B02%3A00&cursor=new",
        type="t/t",
    )
    response = answer(request(), b"{}", "t/t", '"a"', [link])
    assert response.headers["link"] == f'<{link.href}>; rel="next"; type="t/t"'
