"""The log: one line an entry on standard error, as text or JSON, uvicorn's among them.

Neither keys nor positions may get into it. Of an exception only the types and places are written, never the text,
which may hold whatever was sent or stored; other libraries speak only from `warning` upwards, since at `debug` several
write statements and headers with their values.
"""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

from server.web.request_context import CURRENT

LogFormat = Literal["text", "json"]
FIELDS = "headsup_fields"
"""Attribute of a log record with its named values: `extra={FIELDS: {...}}`."""
_OURS = ("server", "headsup")
_QUIET = ("uvicorn", "uvicorn.error", "uvicorn.access")
# The innermost frames of a recursion say it all.
_MOST_FRAMES = 30
_LONGEST_MESSAGE = 500


def configure(level: str, form: LogFormat) -> None:
    """Send the log of this process to standard error."""
    handler = _StandardError()
    handler.setFormatter(JsonLines() if form == "json" else TextLines())
    root = logging.getLogger()
    root.handlers[:] = [item for item in root.handlers if not isinstance(item, _StandardError)] + [handler]
    root.setLevel(logging.WARNING)
    for name in _OURS:
        logging.getLogger(name).setLevel(level.upper())
    for name in _QUIET:
        logger = logging.getLogger(name)
        logger.handlers.clear()
        logger.propagate = True
        logger.setLevel(logging.WARNING)


class _StandardError(logging.Handler):
    """Writes to standard error as it is when something is written: tests and tools exchange it."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write an entry; a full disk or a closed pipe costs the entry, and no request."""
        try:
            sys.stderr.write(self.format(record) + "\n")
            sys.stderr.flush()
        except (OSError, ValueError):
            return


class JsonLines(logging.Formatter):
    """A JSON object a line."""

    def format(self, record: logging.LogRecord) -> str:
        """One entry."""
        return json.dumps(_entry(record), ensure_ascii=True, default=str)


class TextLines(logging.Formatter):
    """Time, level, logger and message, then `name=value`."""

    def format(self, record: logging.LogRecord) -> str:
        """One entry; what an entry has of control characters is escaped."""
        entry = _entry(record)
        head = f"{entry.pop('time')} {entry.pop('level'):7} {entry.pop('logger')}: {entry.pop('message')}"
        text = " ".join([head, *(f"{name}={value}" for name, value in entry.items())])
        return "".join(character if character.isprintable() else repr(character)[1:-1] for character in text)


def _entry(record: logging.LogRecord) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z"),
        "level": record.levelname.lower(),
        "logger": record.name,
        # What asyncio adds behind the first line is the exception as text.
        "message": record.getMessage().partition("\n")[0][:_LONGEST_MESSAGE],
    }
    entry |= getattr(record, FIELDS, {})
    context = CURRENT.get()
    if context is not None:
        named = {"request_id": context.request_id, "trace_id": context.trace_id, "key_id": context.key_id}
        entry |= {name: value for name, value in named.items() if value is not None}
    if record.exc_info and record.exc_info[1] is not None:
        entry["failure"] = [_described(error) for error in _chain(record.exc_info[1])]
    return entry


def _chain(error: BaseException) -> Iterator[BaseException]:
    """The exception and its causes, each once."""
    seen: set[int] = set()
    at: BaseException | None = error
    while at is not None and id(at) not in seen:
        seen.add(id(at))
        yield at
        at = at.__cause__ or at.__context__


def _described(error: BaseException) -> dict[str, Any]:
    described: dict[str, Any] = {"type": f"{type(error).__module__}.{type(error).__qualname__}"}
    state = getattr(error, "sqlstate", None)
    if isinstance(state, str):
        described["sqlstate"] = state
    return described | {"at": list(_places(error.__traceback__))[-_MOST_FRAMES:]}


def _places(frame: TracebackType | None) -> Iterator[str]:
    while frame is not None:
        code = frame.tb_frame.f_code
        path = Path(code.co_filename)
        yield f"{path.parent.name}/{path.name}:{frame.tb_lineno} {code.co_name}"
        frame = frame.tb_next
