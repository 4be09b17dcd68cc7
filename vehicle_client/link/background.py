"""A `ServerLink` in threads of its own, so that the frame loop never waits for the network."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from types import TracebackType
from typing import TypeVar

from contract.geometry import LatLon
from contract.observation import ObservationReport, ReportResult
from vehicle_client.area import Heard
from vehicle_client.link.server_link import LinkStatus, ServerLink

_LOG = logging.getLogger(__name__)

STOP_WITHIN_S = 5.0
"""How long the end of a drive may take: what is not answered by then is on disk, and goes out with the next drive."""

MOST_HEARD = 10_000
"""Messages that the drive has not taken yet. A drive that is stalled for longer than that many loses the oldest."""

T = TypeVar("T")
_IDLE_S = 1.0
_AFTER_FAULT_S = 10.0


class BackgroundLink:
    """The same methods as `ServerLink`, none of which waits for the network; `put` waits for the disk.

    One thread hears, one delivers. A fault in a thread is logged with its trace and shown in `status`; the thread goes
    on after a pause. As a context it ends within `stop_within_s`, with a last delivery if there is time for one.
    """

    def __init__(self, link: ServerLink, *, stop_within_s: float = STOP_WITHIN_S) -> None:
        self._link, self._stop_within_s = link, stop_within_s
        self._here: LatLon | None = None
        self._heard: deque[Heard] = deque(maxlen=MOST_HEARD)
        self._results: deque[ReportResult] = deque(maxlen=MOST_HEARD)
        self._moved, self._has_work, self._ends = threading.Event(), threading.Event(), threading.Event()
        self._faults: dict[str, str] = {}
        self._deadline_s = float("inf")
        self._hearing = threading.Thread(target=self._hear, name="headsup-hearing", daemon=True)
        self._delivering = threading.Thread(target=self._deliver, name="headsup-delivering", daemon=True)

    def __enter__(self) -> BackgroundLink:
        self._hearing.start()
        self._delivering.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._deadline_s = time.monotonic() + self._stop_within_s
        for event in (self._ends, self._moved, self._has_work):
            event.set()
        self._delivering.join(self._stop_within_s)
        self._link.__exit__(kind, error, trace)
        self._hearing.join(max(0.0, self._deadline_s - time.monotonic()))

    @property
    def connected(self) -> bool:
        """Whether the server was heard when it was last asked."""
        return self._link.connected

    @property
    def status(self) -> LinkStatus:
        """How it goes."""
        status = self._link.status
        fault = next(iter(self._faults.values()), None)
        return replace(status, trouble=status.trouble or fault)

    def hear(self, position: LatLon) -> list[Heard]:
        """Say where the car is; what has been heard since the last call. A newer place overtakes one not yet sent."""
        self._here = position
        self._moved.set()
        return _taken(self._heard)

    def put(self, report: ObservationReport) -> None:
        """Keep a report until the server has answered it; it is on disk when this returns."""
        self._link.put(report)
        self._has_work.set()

    def deliver(self) -> list[ReportResult]:
        """What became of reports since the last call."""
        return _taken(self._results)

    def _hear(self) -> None:
        while not self._ends.is_set():
            self._guarded(self._hear_once)

    def _hear_once(self) -> None:
        if not self._moved.wait(_IDLE_S) or self._ends.is_set():
            return
        self._moved.clear()
        if self._here is not None:
            self._heard.extend(self._link.hear(self._here))

    def _deliver(self) -> None:
        while not self._ends.is_set():
            self._guarded(self._deliver_once)
        self._guarded(self._deliver_last)

    def _deliver_once(self) -> None:
        if self._link.delivery_wait_s > 0:
            self._ends.wait(min(self._link.delivery_wait_s, _IDLE_S))
        elif not self._link.waiting:
            self._has_work.wait(_IDLE_S)
        self._has_work.clear()
        self._results.extend(self._link.deliver())

    def _deliver_last(self) -> None:
        self._link.hurry()
        while time.monotonic() < self._deadline_s and (results := self._link.deliver()):
            self._results.extend(results)

    def _guarded(self, step: Callable[[], None]) -> None:
        name = threading.current_thread().name
        try:
            step()
        except Exception as error:  # a drive outlives whatever a library does; the fault is told
            _LOG.exception("%s has a fault, and goes on in %.0f s", name, _AFTER_FAULT_S)
            self._faults[name] = f"{name}: {error!r}"
            self._ends.wait(_AFTER_FAULT_S)
        else:
            self._faults.pop(name, None)


def _taken(items: deque[T]) -> list[T]:
    taken: list[T] = []
    while items:
        taken.append(items.popleft())
    return taken
