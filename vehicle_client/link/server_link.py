"""The way to the server and back: reports through the outbox by HTTP, events by WebSocket. Failing is normal here."""

from __future__ import annotations

import time
from collections import OrderedDict, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from random import Random
from types import TracebackType
from typing import Protocol
from uuid import UUID

from contract.events import Appeared, Updated
from contract.geometry import LatLon
from contract.observation import ObservationReport, ReportResult, ReportStatus
from vehicle_client.area import Heard, Surveyed
from vehicle_client.link.course import Course
from vehicle_client.link.delivery import Deliverer
from vehicle_client.link.http_asking import client_for
from vehicle_client.link.listening import Listener
from vehicle_client.link.outbox import Outbox
from vehicle_client.privacy.report_privacy import Privacy, departing, position_told

TIMEOUT_S = 5.0
"""A server that says nothing for this long is treated as away; the report waits in the outbox."""

WITHHELD = "withheld: quiet zone"
_REMEMBERED = 10_000


@dataclass(frozen=True, slots=True)
class LinkStatus:
    """How it goes, for the driver's status line and the log.

    `way` is how the server is heard. `trouble` is what somebody has to do something about, in a line. `unwritten` of
    the `waiting` reports are not on disk. `fates` counts what became of reports, over all drives on this outbox.
    `unreached_s` is for how long nothing at all has come from the server although it was asked; None once it has.
    """

    way: str
    waiting: int
    unwritten: int
    trouble: str | None
    fates: Mapping[str, int]
    unreached_s: float | None


class Link(Protocol):
    """What a drive needs of a server: `ServerLink` waits for it, `BackgroundLink` never does."""

    def hear(self, position: LatLon) -> Sequence[Heard]:
        """Tell the server where the car is; what it has said of the area."""

    def put(self, report: ObservationReport) -> None:
        """Keep a report until the server has answered it."""

    def deliver(self) -> Sequence[ReportResult]:
        """Send what waits; what became of reports."""


class ServerLink:
    """One vehicle's connection, used by one thread for each of: hearing, delivering, putting.

    Without the server it keeps what is to be sent and hears nothing. Made, it raises `OutboxError` when the file cannot
    be the outbox, `UnusableError` when no request can be made with the address or key; nothing is raised later.
    """

    def __init__(
        self,
        server_url: str,
        api_key: str | None,
        outbox_path: Path,
        *,
        privacy: Privacy | None = None,
        timeout_s: float = TIMEOUT_S,
        jitter: Random | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._privacy = privacy or Privacy()
        jitter = Random() if jitter is None else jitter  # noqa: S311  # jitter, not a secret
        self._listener = Listener(server_url, api_key, timeout_s=timeout_s, jitter=jitter, clock=clock)
        # A server whose database is slow says so after 5 s: that is to be heard.
        self._client = client_for(server_url, api_key, 2 * timeout_s)
        self._outbox = Outbox(outbox_path)
        self._deliverer = Deliverer(self._outbox, self._client, jitter=jitter, clock=clock)
        self._course = Course()
        self._places: OrderedDict[UUID, LatLon] = OrderedDict()
        self._withheld: deque[ReportResult] = deque(maxlen=_REMEMBERED)
        self._clock = clock
        self._first_asked_s: float | None = None
        self._was_reached = False

    def __enter__(self) -> ServerLink:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._listener.close()
        self._client.close()
        self._outbox.close()

    @property
    def connected(self) -> bool:
        """Whether the server was heard when it was last asked."""
        return self._listener.is_pushed or self._listener.is_polling

    @property
    def status(self) -> LinkStatus:
        """How it goes."""
        listener = self._listener
        refusal = self._deliverer.refusal or listener.refusal
        return LinkStatus(
            way="push" if listener.is_pushed else "polling" if listener.is_polling else "none",
            waiting=self._outbox.waiting,
            unwritten=self._outbox.unwritten,
            trouble=refusal or self._outbox.trouble,
            fates=self._outbox.counts,
            unreached_s=self._unreached_s(refusal),
        )

    @property
    def waiting(self) -> int:
        """Reports that have not been answered."""
        return self._outbox.waiting

    @property
    def delivery_wait_s(self) -> float:
        """Seconds until reports are sent again; 0 when that is due."""
        return self._deliverer.wait_s

    def hear(self, position: LatLon) -> list[Heard]:
        """Tell the server where the car is; what it says of the area. Empty when it cannot be reached."""
        told = position_told(position, self._privacy)
        if told is None:
            return []
        self._course = self._course.after(position)
        was_connected = self.connected
        self._note_asked()
        heard = self._listener.hear(told, self._course.heading_rad)
        self._was_reached |= self.connected
        if self.connected and not was_connected:
            self.hurry()
        for message in heard:
            self._remember_places(message)
        return heard

    def put(self, report: ObservationReport) -> None:
        """Keep a report, as far as it may leave the car, until the server has answered it."""
        leaving = departing(report, self._privacy, self._places.get)
        if leaving is None:
            self._withheld.append(
                ReportResult(report_id=report.report_id, status=ReportStatus.REJECTED, reason=WITHHELD)
            )
        else:
            self._outbox.put(leaving)

    def deliver(self) -> list[ReportResult]:
        """Send one batch of what waits; what became of reports: the server's answers, and what was given up here."""
        withheld = [self._withheld.popleft() for _ in range(len(self._withheld))]
        if self._outbox.waiting:
            self._note_asked()
        results = self._deliverer.deliver()
        self._was_reached |= any(result.status is not ReportStatus.REJECTED for result in results)
        return withheld + results

    def hurry(self) -> None:
        """Let the next delivery be due at once, unless the server itself has asked to wait."""
        self._deliverer.hurry()

    def _unreached_s(self, refusal: str | None) -> float | None:
        if self._first_asked_s is None or self._was_reached or refusal is not None:
            return None
        return self._clock() - self._first_asked_s

    def _note_asked(self) -> None:
        if self._first_asked_s is None:
            self._first_asked_s = self._clock()

    def _remember_places(self, message: Heard) -> None:
        """Where obstacles lie, for inspections that must not leave a quiet zone."""
        match message:
            case Surveyed(obstacles=features):
                pass
            case Appeared(obstacle=feature) | Updated(obstacle=feature):
                features = (feature,)
            case _:
                return
        for feature in features if self._privacy.zones else ():
            self._places[feature.id] = feature.position
            self._places.move_to_end(feature.id)
        while len(self._places) > _REMEMBERED:
            self._places.popitem(last=False)
