"""Work beside the drive: what takes its time, and what no warning may wait for."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")

_LOG = logging.getLogger(__name__)


class Beside(Generic[T]):
    """Does `work` on one item after the other in a thread of its own; those that it cannot keep up with are left out.

    After an item on which it fails it does nothing more, and `close` raises what went wrong.
    """

    def __init__(self, work: Callable[[T], None], *, name: str, most_waiting: int) -> None:
        self._work = work
        self._waiting: queue.Queue[tuple[T] | None] = queue.Queue(most_waiting)
        self._failed: Exception | None = None
        self.dropped = 0
        self._thread = threading.Thread(target=self._work_off, name=name, daemon=True)
        self._thread.start()

    def add(self, item: T) -> None:
        """Keep an item for the thread, never waiting for it."""
        try:
            self._waiting.put_nowait((item,))
        except queue.Full:
            self.dropped += 1
            if self.dropped == 1:
                _LOG.warning("%s cannot keep up with the drive: it leaves frames out", self._thread.name)

    def close(self) -> None:
        """Do what waits; what went wrong in the thread is raised here."""
        self._waiting.put(None)
        self._thread.join()
        if self.dropped:
            _LOG.warning("%s left %d frames out", self._thread.name, self.dropped)
        if self._failed is not None:
            raise self._failed

    def _work_off(self) -> None:
        while (waiting := self._waiting.get()) is not None:
            if self._failed is None:
                self._try(*waiting)

    def _try(self, item: T) -> None:
        try:
            self._work(item)
        except Exception as error:  # a thread's exception would be lost, and nobody know why nothing comes any more
            _LOG.exception("%s fails", self._thread.name)
            self._failed = error
