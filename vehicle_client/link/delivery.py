"""Reports from the outbox to the server, one batch a call, as the answers allow (`verdict`)."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from random import Random
from uuid import UUID

import httpx

from contract.observation import MAX_REPORTS, ReportResult
from vehicle_client.link.back_off import delay_s
from vehicle_client.link.http_asking import ask
from vehicle_client.link.outbox import Kept, Outbox
from vehicle_client.link.verdict import Drop, Halve, Retry, SetAside, Settle, Stop, Verdict, verdict

_LOG = logging.getLogger(__name__)

STOPPED_S = 300.0
"""A key may be renewed or a proxy mended at any time; once in five minutes is no burden to a server that refuses."""

ANSWER_WITHIN_S = 60.0
"""A mebibyte takes 24 s at 350 kbit/s, the edge of mobile coverage; the server cuts bodies off after 30 s."""

FRUITLESS_AT_ONCE = 20
"""Requests in a row without a report taken that go without a wait: more than it takes to find the one that is not."""

DROPPED_IN_ROW = 3
"""Reports dropped on the word of a server that takes none: a server of another version must not empty the outbox."""

_SET_ASIDE_MOST = 1_000
_JSON = {"content-type": "application/json", "accept-encoding": "identity"}

Clock = Callable[[], float]


class Deliverer:
    """Sends what waits. It keeps to the waits that it was told and those of its own back-off: call it often.

    `clock` is any that never goes back, in seconds.
    """

    def __init__(
        self, outbox: Outbox, client: httpx.Client, *, jitter: Random | None = None, clock: Clock = time.monotonic
    ) -> None:
        self._outbox, self._client, self._clock = outbox, client, clock
        self._jitter = Random() if jitter is None else jitter  # noqa: S311  # jitter, not a secret
        self._most = self._ceiling = MAX_REPORTS
        self._suspects: frozenset[UUID] = frozenset()
        self._aside: dict[UUID, tuple[int, float]] = {}
        self._failures = self._fruitless = self._dropped = 0
        self._next_s = self._asked_s = clock()
        self.refusal: str | None = None
        """Why the server takes nothing of this vehicle before somebody does something; None while it does."""

    @property
    def wait_s(self) -> float:
        """Seconds until the next attempt; 0 when it is due, or when there is nothing to send."""
        now_s, aside = self._clock(), self._set_aside()
        # The server's wait holds for all reports, that of a report set aside for itself.
        due_s = min(self._aside[i][1] for i in aside) if aside and self._outbox.waiting <= len(aside) else now_s
        return max(0.0, self._next_s - now_s, due_s - now_s)

    def hurry(self) -> None:
        """Let the next attempt be due at once, unless the server itself has asked to wait: the network is back."""
        self._next_s = min(self._next_s, self._asked_s)

    def deliver(self) -> list[ReportResult]:
        """Send one batch if that is due; what became of reports, by the server or given up here.

        What the network or the server did not answer stays for another call: nothing is lost, nothing is raised.
        """
        results = self._delivered() if self.wait_s == 0 else []
        return results + self._outbox.take_given_up()

    def _delivered(self) -> list[ReportResult]:
        kept = self._outbox.batch(self._most, only=self._suspects, without=self._set_aside())
        if not kept and self._suspects:
            self._suspects = frozenset()
            kept = self._outbox.batch(self._most, without=self._set_aside())
        if not kept:
            return []
        try:
            sent_at = datetime.now(UTC)
            answer = ask(
                self._client,
                "POST",
                "/v1/observations",
                within_s=ANSWER_WITHIN_S,
                content=_batch(sent_at, kept),
                headers=_JSON,
            )
        except httpx.RequestError as error:
            is_too_much = isinstance(error, httpx.ReadTimeout | httpx.WriteTimeout)
            return self._obey(Retry(f"no answer: {error!r}", fewer=is_too_much), kept)
        sent = [item.report_id for item in kept]
        return self._obey(verdict(answer.status, answer.headers, answer.content, sent, sent_at), kept)

    def _obey(self, told: Verdict, kept: Sequence[Kept]) -> list[ReportResult]:
        sent = [item.report_id for item in kept]
        match told:
            case Settle(results):
                self._outbox.settle(results)
                self._aside = {i: entry for i, entry in self._aside.items() if i not in sent}
                self._goes_well()
                if len(results) < len(sent):
                    self._wait(None)
                return list(results)
            case Halve(reason):
                _LOG.info("a batch of %d is not taken, halving it: %s", len(sent), reason)
                self._suspects, self._most = frozenset(sent), len(sent) // 2
                self._was_fruitless(reason)
            case Drop(reason) if self._dropped < DROPPED_IN_ROW:
                self._outbox.drop(sent[0], reason)
                self._aside.pop(sent[0], None)
                self._dropped += 1
                self._was_fruitless(reason)
            case Drop(reason) | SetAside(reason):
                _LOG.warning("report %s is set aside: %s", sent[0], reason)
                self._put_aside(sent[0])
                self._was_fruitless(reason)
            case Retry(reason, after_s, fewer):
                _LOG.info("the server is to be asked again: %s", reason)
                if fewer:
                    self._most = self._ceiling = max(1, len(sent) // 2)
                self._wait(after_s)
            case Stop(reason):
                self._refused(reason)
        return []

    def _goes_well(self) -> None:
        if self.refusal is not None:
            _LOG.warning("the server takes reports again")
        self.refusal = None
        self._failures = self._fruitless = self._dropped = 0
        # As TCP's slow start and its threshold: what a slow link did not carry is approached by one report at a time.
        self._ceiling = min(self._ceiling + 1, MAX_REPORTS)
        self._most = min(2 * self._most, self._ceiling)

    def _was_fruitless(self, reason: str) -> None:
        """The server has read a request, and taken nothing of it."""
        self._fruitless += 1
        if self._fruitless > FRUITLESS_AT_ONCE:
            self._say_refusal(f"every report is refused: {reason}")
            wait_s = delay_s(self._fruitless - FRUITLESS_AT_ONCE, self._jitter.random())
            self._next_s = self._asked_s = self._clock() + wait_s

    def _wait(self, after_s: float | None) -> None:
        self._failures += 1
        now_s = self._clock()
        self._next_s = now_s + delay_s(self._failures, self._jitter.random(), after_s)
        self._asked_s = now_s if after_s is None else self._next_s

    def _refused(self, reason: str) -> None:
        self._say_refusal(reason)
        self._next_s = self._asked_s = self._clock() + STOPPED_S * (1 + self._jitter.random() / 10)

    def _say_refusal(self, reason: str) -> None:
        if self.refusal is None:
            _LOG.error("the server takes no reports of this vehicle, they are kept: %s", reason)
        self.refusal = reason

    def _put_aside(self, report_id: UUID) -> None:
        failures = self._aside.pop(report_id, (0, 0.0))[0] + 1
        self._aside[report_id] = failures, self._clock() + delay_s(failures + 4, self._jitter.random())
        if len(self._aside) > _SET_ASIDE_MOST:
            del self._aside[next(iter(self._aside))]

    def _set_aside(self) -> set[UUID]:
        now_s = self._clock()
        return {report_id for report_id, (_, until_s) in self._aside.items() if until_s > now_s}


def _batch(sent_at: datetime, kept: Sequence[Kept]) -> bytes:
    """An `ObservationBatch` of reports that are JSON already."""
    reports = ",".join(item.body for item in kept)
    return f'{{"sent_at":"{sent_at.isoformat()}","reports":[{reports}]}}'.encode()
