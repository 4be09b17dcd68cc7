"""Whether the database takes writes: why it last took none, until one succeeds."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from types import MappingProxyType

from sqlalchemy.exc import DBAPIError

_LOG = logging.getLogger(__name__)
_FULL, _READ_ONLY, _BROKEN = "the disk is full", "the database is read-only", "the disk has failed"
# By the beginning of SQLite's messages, and by PostgreSQL's states: disk_full, read_only_sql_transaction, io_error.
_BY_MESSAGE = MappingProxyType(
    {
        "database or disk is full": _FULL,
        "attempt to write a readonly database": _READ_ONLY,
        "disk I/O error": _BROKEN,
    }
)
_BY_STATE = MappingProxyType({"53100": _FULL, "25006": _READ_ONLY, "58030": _BROKEN})


def storage_failure(error: DBAPIError) -> str | None:
    """What is wrong with the database's storage, if that is what failed."""
    state = getattr(error.orig, "sqlstate", None)
    if state is not None:
        return _BY_STATE.get(state)
    message = str(error.orig)
    return next((what for start, what in _BY_MESSAGE.items() if message.startswith(start)), None)


class WriteHealth:
    """Of one process. A change for the worse or the better is logged once."""

    def __init__(self) -> None:
        self.failure: str | None = None
        """Why the last write failed; None when it did not, or for a reason of its own."""

    @contextmanager
    def watched(self) -> Iterator[None]:
        """Around a write transaction and its commit."""
        try:
            yield
        except DBAPIError as error:
            self._failed(storage_failure(error))
            raise
        if self.failure is not None:
            self.failure = None
            _LOG.warning("the database takes writes again")

    def _failed(self, failure: str | None) -> None:
        if failure is None or failure == self.failure:
            return
        self.failure = failure
        _LOG.error("the database takes no writes: %s", failure)
