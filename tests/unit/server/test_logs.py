"""Lines of the log."""

from __future__ import annotations

import io
import json
import logging
import sys

import pytest

from server.logs import FIELDS, JsonLines, TextLines, configure
from server.web.request_context import CURRENT, RequestContext

SENSITIVE = "hu_a-key-and-38.2466-21.7346"


def record(message: str, error: BaseException | None = None, **fields: object) -> logging.LogRecord:
    info = None if error is None else (type(error), error, error.__traceback__)
    made = logging.LogRecord("server.somewhere", logging.WARNING, __file__, 1, message, (), info)
    setattr(made, FIELDS, fields)
    return made


def raised() -> Exception:
    try:
        try:
            raise KeyError(SENSITIVE)
        except KeyError as cause:
            raise ValueError(f"no place {SENSITIVE}") from cause
    except ValueError as error:
        return error


@pytest.mark.parametrize("form", [JsonLines(), TextLines()])
def test_an_exception_is_told_by_type_and_place_and_never_by_its_text(form: logging.Formatter) -> None:
    line = form.format(record("failed", raised()))
    assert SENSITIVE not in line
    assert "builtins.ValueError" in line
    assert "builtins.KeyError" in line
    assert "test_logs.py" in line
    assert "\n" not in line


@pytest.mark.parametrize("form", [JsonLines(), TextLines()])
def test_an_entry_is_one_line_whatever_is_in_it(form: logging.Formatter) -> None:
    line = form.format(record("first\nfuture: <Task exception=" + SENSITIVE, route="a\r\nb\x1b[31m\u2028"))
    assert SENSITIVE not in line
    assert len(line.splitlines()) == 1
    assert "\x1b" not in line


def test_an_entry_carries_the_request_it_belongs_to() -> None:
    before = CURRENT.set(RequestContext("req-7", "ab" * 16, key_id="k1"))
    try:
        entry = json.loads(JsonLines().format(record("request", status=200, duration_ms=1.5)))
    finally:
        CURRENT.reset(before)
    assert entry["time"].endswith("Z")
    assert {name: entry[name] for name in ("request_id", "trace_id", "key_id", "status", "level", "message")} == {
        "request_id": "req-7",
        "trace_id": "ab" * 16,
        "key_id": "k1",
        "status": 200,
        "level": "warning",
        "message": "request",
    }


def test_a_chain_of_causes_that_bites_its_tail_ends() -> None:
    error = ValueError("x")
    other = KeyError("y")
    error.__cause__, other.__cause__ = other, error
    assert len(json.loads(JsonLines().format(record("failed", error)))["failure"]) == 2


def test_a_log_that_cannot_be_written_stops_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    root, ours = logging.getLogger(), logging.getLogger("server")
    before, level = root.handlers[:], ours.level
    try:
        configure("info", "text")
        once = len(root.handlers)
        configure("info", "json")
        assert len(root.handlers) == once
        lines = io.StringIO()
        monkeypatch.setattr(sys, "stderr", lines)
        ours.info("still here")
        lines.flush()
        assert json.loads(lines.getvalue())["message"] == "still here"
        lines.close()
        ours.info("lost")
    finally:
        root.handlers[:] = before
        ours.setLevel(level)
