"""Requests that no honest caller sends, made from a seed: as bytes, since much of it no HTTP client would send."""

from __future__ import annotations

import asyncio
import base64
import copy
import json
import random
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any
from urllib.parse import quote

from contract.observation import ObservationBatch
from tests.unit.server.making import HOUR, absent, detection, message

_NASTY: list[Any] = [
    None, True, "", "\ud800", "\x00", "a" * 70_000, "9999-12-31T23:59:59.999999-14:00", "0001-01-01T00:00:00+14:00",
    "2026-02-30T00:00:00Z", "../../etc/passwd", "' OR 1=1 --", "{{7*7}}", -1, 0, 2**31, 2**63, -(2**64), 10**400, 1e308,
    -1e308, 5e-324, float("nan"), float("inf"), float("-inf"), [], {}, [[]], {"": {}}, [0] * 5_000,
    {"a": [{"b": None}]},
]  # fmt: skip
_JSON = "application/json"
_TYPES = [_JSON, _JSON, _JSON, "application/json; charset=utf-16", "text/plain", "", "multipart/form-data; boundary=x",
          "application/x-www-form-urlencoded", "application/json\t;;;=", "a" * 5_000]  # fmt: skip
_ID = "01a202f3-bf2b-7685-b49c-05b2809ef402"
_PATHS = [
    "/v1/obstacles", "/v1/obstacles", "/v1/obstacles", f"/v1/obstacles/{_ID}", f"/v1/obstacles/{_ID}/history",
    f"/v1/obstacles/{_ID}/points", "/v1/actions", "/ogc", "/ogc/collections/obstacles/items",
    f"/ogc/collections/obstacles/items/{_ID}", "/readyz", "/v1/obstacles/%00", "/v1/obstacles/%ff%fe/history",
    "/v1/%2e%2e/x",
    "//v1/obstacles", "/v1/events", "*",
]  # fmt: skip
_NAMES = ["lat", "lon", "radius_m", "bbox", "kind", "state", "min_confidence", "seen_since", "heading_deg",
"corridor_m",
          "limit", "cursor", "f", "version", "datetime", "count", "obstacle_id", "x"]  # fmt: skip
_VALUES = [
    "38.2466", "21.7346", "0", "-0", "90", "-90", "180", "-180", "90.0000001", "nan", "inf", "1e400", "-1e-400",
    "1_0", "٣",
    "%", "%zz", "%00", "%ff%fe", "%ed%a0%80", "+", "0x10", "1000", "1001", "9" * 400, "pothole", "pothole,,bump",
    "removed",
    "0,0,1,1", "170,-10,-170,10", "-180,-90,180,90", "nan,0,1,1", "0,0,0", "2026-01-01T00:00:00Z",
    "../2026-01-01T00:00:00Z",
    "9999-12-31T23:59:59-14:00", "geojson", "denm", "datex", "html", _ID, "a" * 20_000,
]  # fmt: skip
_HEADERS = [
    ("If-None-Match", '*, W/"'), ("If-None-Match", '"' * 5_000), ("If-None-Match", "\xff\xfe"),
    ("If-Match", '"0-geojson"'),
    ("If-Match", '"99999999999999999999-denm"'), ("If-Match", ""), ("Accept", "*/*;q=nan"), ("Accept", ";;;,,,/"),
    ("Accept", "application/" + "x" * 30_000), ("Accept", "application/geo+json;q=-1, */*;q=0"),
    ("Accept-Encoding", "gzip;q="),
    ("Accept-Encoding", "gzip;q=1e400"), ("traceparent", "00-" + "0" * 32 + "-" + "0" * 16 + "-01"),
    ("traceparent", "ff"),
    ("X-Request-Id", "a b\x01c"), ("X-Request-Id", "x" * 10_000), ("Host", "[::1"), ("Host", "a b"), ("Host", "\xe9"),
    ("Authorization", "Bearer"), ("Authorization", "Basic !!!"), ("Authorization", "Bearer \xff\xfe"),
    ("Expect", "100-continue"),
    ("Range", "bytes=5-2"), ("X-Forwarded-For", "not-an-address"), ("Cookie", "a" * 30_000), ("Upgrade", "websocket"),
    ("Content-Encoding", "gzip"), ("Transfer-Encoding", "gzip, chunked"), ("Connection", "upgrade, close"),
]  # fmt: skip
_METHODS = ["GET", "GET", "GET", "GET", "HEAD", "OPTIONS", "DELETE", "PUT", "PATCH", "TRACE", "BREW"]


class Hostile:
    """A stream of hostile requests; the same seed gives the same."""

    def __init__(self, seed: int) -> None:
        self._chance = random.Random(seed)  # noqa: S311
        self._makers: list[Callable[[], bytes]] = [
            self._mutated, self._mutated, self._mutated, self._garbled, self._nested, self._query, self._query,
            self._query,
            self._tampered_cursor, self._framing, self._action,
        ]  # fmt: skip

    def request(self) -> bytes:
        """One request, or what pretends to be one."""
        return self._chance.choice(self._makers)()

    def _nasty(self) -> Any:
        # A copy: what was put in may be mutated next.
        return copy.deepcopy(self._chance.choice(_NASTY))

    def _mutated(self) -> bytes:
        """A valid batch with one to three members replaced, removed or added."""
        body = _batch()
        for _ in range(self._chance.randint(1, 3)):
            self._mutate(body)
        return self._post("/v1/observations", json.dumps(body).encode("utf-8", "surrogatepass"))

    def _mutate(self, value: Any) -> None:
        while True:
            keys = list(value) if isinstance(value, dict) else list(range(len(value)))
            if not keys:
                return
            key = self._chance.choice(keys)
            inner = value[key]
            if isinstance(inner, dict | list) and inner and self._chance.random() < 0.8:
                value = inner
                continue
            turn = self._chance.random()
            if turn < 0.8:
                value[key] = self._nasty()
            elif turn < 0.9:
                del value[key]
            elif isinstance(value, dict):
                value[str(self._nasty())] = self._nasty()
            return

    def _garbled(self) -> bytes:
        """A valid body with bytes flipped, cut off, or in another encoding."""
        body = bytearray(json.dumps(_batch()).encode())
        for _ in range(self._chance.randint(1, 8)):
            body[self._chance.randrange(len(body))] = self._chance.randrange(256)
        turn = self._chance.randrange(5)
        if turn == 0:
            del body[self._chance.randrange(len(body)) :]
        elif turn == 1:
            return self._post("/v1/observations", json.dumps(_batch()).encode("utf-16"))
        elif turn == 2:
            body = bytearray(self._chance.randbytes(self._chance.randrange(2_000)))
        return self._post("/v1/observations", bytes(body))

    def _nested(self) -> bytes:
        depth = self._chance.choice((100, 5_000, 300_000))
        opening, closing = self._chance.choice((("[", "]"), ('{"a":', "}"), ('{"reports":[', "]}")))
        depth = min(depth, 900_000 // len(opening + closing))
        body = opening * depth + "1" + (closing * depth if self._chance.random() < 0.5 else "")
        return self._post("/v1/observations", body.encode())

    def _action(self) -> bytes:
        body: Any = {"action": self._chance.choice(("confirm", "dismiss", "repaired", "inspection_state", "x"))}
        body[self._chance.choice(("note", "action", "inspection_state", "x"))] = self._nasty()
        return self._post(f"/v1/obstacles/{_ID}/actions", json.dumps(body).encode())

    def _query(self) -> bytes:
        number = self._chance.choice((0, 1, 2, 3, 3, 4, 5, 2_000))
        parts = [f"{self._chance.choice(_NAMES)}={self._value()}" for _ in range(number)]
        if self._chance.random() < 0.5:
            parts += ["lat=38.2466", "lon=21.7346"]
        target = f"{self._chance.choice(_PATHS)}?{'&'.join(parts)}"[:60_000]
        return self._head(self._chance.choice(_METHODS), target) + b"\r\n"

    def _value(self) -> str:
        value = self._chance.choice(_VALUES)
        return value if "%" in value or "+" in value else quote(value)

    def _tampered_cursor(self) -> bytes:
        position = [self._chance.choice(["70ba", 1, None, [], {}, "x" * 12]), *self._chance.choices(_NASTY[:-2], k=2)]
        text = json.dumps(position)[:150].encode("utf-8", "surrogatepass")
        cursor = quote(base64.urlsafe_b64encode(text).decode().rstrip("="))
        path = self._chance.choice(("/v1/obstacles?lat=1&lon=1&", "/v1/actions?", f"/v1/obstacles/{_ID}/history?"))
        return self._head("GET", f"{path}cursor={cursor}") + b"\r\n"

    def _framing(self) -> bytes:
        """Lengths that lie, chunks that are none, requests that end early."""
        head, body = self._head("POST", "/v1/observations", _JSON), json.dumps(_batch()).encode()
        return self._chance.choice(
            [
                head + b"Content-Length: 99999\r\n\r\n" + body[:100],
                head + b"Content-Length: 5\r\n\r\n" + body,
                head + b"Content-Length: -1\r\n\r\n" + body,
                head + b"Content-Length: 99999999999999999999\r\n\r\n" + body,
                head + b"Content-Length: 3\r\nContent-Length: 4\r\n\r\n" + body,
                head + b"Transfer-Encoding: chunked\r\n\r\n" + b"10\r\n" + body[:5],
                head + b"Transfer-Encoding: chunked\r\n\r\n" + b"FFFFFFFFFFFFFFFFFF\r\n" + body,
                head + b"Transfer-Encoding: chunked\r\n\r\n" + b"zz\r\n" + body,
                head + b"Transfer-Encoding: chunked\r\nContent-Length: 4\r\n\r\n0\r\n\r\n",
                head + b"Content-Length: 1048577\r\n\r\n" + b" " * 1_048_577,
                head[: self._chance.randrange(1, len(head))],
                self._chance.randbytes(300),
                b"GET / HTTP/9.9\r\n\r\n",
                b"GET /v1/obstacles\x00 HTTP/1.1\r\nHost: x\r\n\r\n",
                head + b"X: " + b"a" * 200_000 + b"\r\n\r\n",
                head + b"".join(b"X-%d: 1\r\n" % number for number in range(2_000)) + b"\r\n",
            ]
        )

    def _post(self, target: str, body: bytes) -> bytes:
        media_type = self._chance.choice(_TYPES) if self._chance.random() < 0.2 else _JSON
        return self._head("POST", target, media_type) + b"Content-Length: %d\r\n\r\n" % len(body) + body

    def _head(self, method: str, target: str, media_type: str | None = None) -> bytes:
        lines = [f"{method} {target} HTTP/1.1", "Host: 127.0.0.1"]
        if media_type is not None:
            lines.append(f"Content-Type: {media_type}")
        if self._chance.random() < 0.25:
            lines.append(": ".join(self._chance.choice(_HEADERS)))
        return ("\r\n".join([*lines, "Connection: close"]) + "\r\n").encode("latin-1", "replace")


def _batch() -> Any:
    at = datetime.now(UTC) - HOUR
    report = message(detection(), detection(20, 20), inspections=(absent(message().report_id),), at=at)
    batch = ObservationBatch(sent_at=datetime.now(UTC), reports=(report,))
    return batch.model_dump(mode="json")


async def status_of(port: int, request: bytes, patience_s: float) -> int:
    """Status of the answer to raw bytes; 0 when there is none within `patience_s`, or the connection ends."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        writer.write(request)
        async with asyncio.timeout(patience_s):
            line = await reader.readline()
            # An interim answer, to `Expect`, is followed by the real one.
            while line.startswith(b"HTTP/1.1 1"):
                while (await reader.readline()).strip():
                    pass
                line = await reader.readline()
    except (ConnectionError, TimeoutError):
        return 0
    finally:
        writer.close()
    return int(line.split(b" ", 2)[1]) if line.startswith(b"HTTP/") else 0
