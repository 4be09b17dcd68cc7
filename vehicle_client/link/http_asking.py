"""One question over HTTP, bounded in time and size: a server, or what stands in its place, is trusted no further."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from urllib.parse import urlsplit

import httpx

API_KEY_VARIABLE = "HEADSUP_API_KEY"
"""Where whoever begins a drive puts the vehicle's key."""

KEY_NEEDED = f"set {API_KEY_VARIABLE} to a key that this server has made with `headsup keys create --role vehicle`"
"""What to do about 401 and 403."""

MAX_ANSWER_BYTES = 8 << 20
"""A page of a thousand obstacles takes one mebibyte; answers to a batch of reports take a fraction of it."""


class UnusableError(ValueError):
    """An address or a key that no request can be made with."""


@dataclass(frozen=True, slots=True)
class Answer:
    """Status, headers by their lower-case names, and the whole body."""

    status: int
    headers: Mapping[str, str]
    content: bytes


def client_for(server_url: str, api_key: str | None, timeout_s: float) -> httpx.Client:
    """A client of a server. Raises `UnusableError` for an address or key that cannot be used."""
    headers = {"Authorization": f"Bearer {api_key}"} if api_key else {}
    try:
        parts = urlsplit(server_url)
        client = httpx.Client(base_url=server_url, headers=headers, timeout=timeout_s)
    except (httpx.InvalidURL, ValueError) as error:
        raise UnusableError(f"{server_url} cannot be asked with this key: {error}") from None
    if parts.scheme not in ("http", "https") or not parts.hostname:
        raise UnusableError(
            f"{server_url} cannot be asked: give the server's address as https://HOST or http://HOST:PORT"
        )
    return client


def ask(
    client: httpx.Client,
    method: str,
    url: str,
    *,
    within_s: float,
    content: bytes | None = None,
    headers: Mapping[str, str] | None = None,
    params: Mapping[str, str] | None = None,
) -> Answer:
    """Ask, and read the answer within `within_s` and `MAX_ANSWER_BYTES`. Raises `httpx.RequestError` if there is none.

    Time and size are counted as bytes come in; between two bytes the client's own time-out holds.
    """
    deadline_s = time.monotonic() + within_s
    with client.stream(method, url, content=content, headers=headers, params=params) as response:
        body = bytearray()
        for chunk in response.iter_bytes():
            body += chunk
            if len(body) > MAX_ANSWER_BYTES:
                raise httpx.ReadError(f"the answer exceeds {MAX_ANSWER_BYTES} bytes")
            if time.monotonic() > deadline_s:
                raise httpx.ReadTimeout(f"the answer was not complete within {within_s} s")
        return Answer(response.status_code, response.headers, bytes(body))
