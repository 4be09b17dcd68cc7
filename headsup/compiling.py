"""Says that inner loops are being compiled: numba does it at their first use on a machine and keeps what it made."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from numba.core import event

COMPILING = "numba:compile"

SILENT_S = 1.0
"""One loop that meets a new type of array is compiled within this, and nobody need know."""


@contextmanager
def said_while_compiling(command: str) -> Iterator[None]:
    """Within the block, a line on standard error when compiling takes longer than a moment; once a block."""
    listener = _Saying(f"headsup {command}")
    event.register(COMPILING, listener)
    try:
        yield
    finally:
        event.unregister(COMPILING, listener)


class _Saying(event.Listener):  # type: ignore[misc]  # numba has no types
    def __init__(self, who: str) -> None:
        self._who = who
        self._changes = threading.Lock()
        self._depth = 0
        self._begun_s = self._spent_s = 0.0
        self._is_said = False

    def on_start(self, _: event.Event) -> None:
        with self._changes:
            now_s = time.monotonic()
            if self._depth == 0:
                self._begun_s = now_s
            self._depth += 1
            if not self._is_said and self._spent_s + now_s - self._begun_s > SILENT_S:
                self._is_said = True
                print(f"{self._who}: compiling for this machine, once: up to a minute", file=sys.stderr)

    def on_end(self, _: event.Event) -> None:
        with self._changes:
            self._depth -= 1
            if self._depth == 0:
                self._spent_s += time.monotonic() - self._begun_s
