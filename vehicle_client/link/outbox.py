"""Reports wait here, on disk, until the server has answered; while the disk takes nothing, in memory.

Bounded by `MOST_BYTES`. When it is full, the oldest reports without a detection give way first (others will look at
those places too), then the oldest: what is lost is counted, as is the fate of every report.
"""

from __future__ import annotations

import logging
import threading
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import accumulate, zip_longest
from pathlib import Path
from uuid import UUID

from contract.observation import MAX_BODY_BYTES, MAX_REPORTS, ObservationReport, ReportResult, ReportStatus
from vehicle_client.link.outbox_file import DiskError, OutboxError, OutboxFile, Statement

__all__ = ["Kept", "Outbox", "OutboxError"]

_LOG = logging.getLogger(__name__)

MOST_BYTES = 64 << 20
"""Some 10,000 reports: far more than the week after which the server takes none of them."""

MEMORY_BYTES = 8 << 20
"""What is kept without a disk: a day's reports of a car, and little of a small computer's memory."""

BATCH_BYTES = MAX_BODY_BYTES - 1024
"""Reports of one batch together; the rest is for what the batch itself says."""

OLD_TO_NEW = 3
"""Of a backlog three old reports go with each new one: what others are about to meet does not wait for yesterday's."""

DROPPED_KEPT = 100
"""Dropped reports whose text is kept for whoever wants to know why; all are counted."""

GIVEN_UP_KEPT = 1_000
"""Fates of reports given up here that nobody has asked for yet."""

REFUSED, NO_ROOM, LOST = "refused", "no-room", "lost"


@dataclass(frozen=True, slots=True)
class Kept:
    """A report as it was put, in JSON."""

    report_id: UUID
    body: str


@dataclass(frozen=True, slots=True)
class _Entry:
    """A report that waits."""

    size_bytes: int
    sees: bool


@dataclass(slots=True)
class _Unwritten:
    """What the file does not know yet."""

    texts: dict[UUID, str] = field(default_factory=dict)
    settled: set[UUID] = field(default_factory=set)
    dropped: list[tuple[str, str, str, str]] = field(default_factory=list)
    tally: Counter[str] = field(default_factory=Counter)

    def statements(self, entries: Mapping[UUID, _Entry]) -> list[Statement]:
        """What brings the file up to date."""
        every: list[Statement] = [
            (
                "INSERT OR IGNORE INTO report (id, sees, body) VALUES (?, ?, ?)",
                [(str(i), entries[i].sees, text) for i, text in self.texts.items()],
            ),
            ("DELETE FROM report WHERE id = ?", [(str(i),) for i in self.settled]),
            ("INSERT INTO dropped (id, reason, dropped_at, body) VALUES (?, ?, ?, ?)", self.dropped),
            (
                "DELETE FROM dropped WHERE position <= (SELECT max(position) FROM dropped) - ?",
                [(DROPPED_KEPT,)] if self.dropped else [],
            ),
            (
                "INSERT INTO tally (fate, number) VALUES (?, ?)"
                " ON CONFLICT (fate) DO UPDATE SET number = number + excluded.number",
                list(self.tally.items()),
            ),
        ]
        return [statement for statement in every if statement[1]]


class Outbox:
    """A durable queue of reports. A report leaves it only when it is answered, or for want of room.

    Safe for several threads. Made, it raises `OutboxError` when the file belongs to another process or program; a disk
    that is full or fails raises nothing (`trouble` says it).
    """

    def __init__(self, path: Path | str, *, most_bytes: int = MOST_BYTES) -> None:
        self._lock = threading.RLock()
        self._file = OutboxFile(Path(path))
        self._most_bytes = most_bytes
        self._entries: dict[UUID, _Entry] = {}
        self._size_bytes = 0
        self._unwritten = _Unwritten()
        self._counts: Counter[str] = Counter()
        self._given_up: list[ReportResult] = []
        self._is_read = self._is_closed = False
        self.trouble: str | None = None
        """Why the disk takes nothing, while that is so."""
        with self._lock:
            self._synchronise()

    @property
    def waiting(self) -> int:
        """Reports that have not been answered."""
        return len(self._entries)

    @property
    def unwritten(self) -> int:
        """Those of them that are in memory only."""
        return len(self._unwritten.texts)

    @property
    def counts(self) -> Mapping[str, int]:
        """How many reports had each fate: `accepted`, `duplicate`, `rejected`, `refused`, ...; over all drives."""
        with self._lock:
            return dict(self._counts + self._unwritten.tally)

    def put(self, report: ObservationReport) -> None:
        """Keep a report until it is answered; it is on disk when this returns, unless there is `trouble`."""
        text = report.model_dump_json()
        with self._lock:
            if report.report_id in self._entries:
                return
            self._entries[report.report_id] = _Entry(len(text), bool(report.detections))
            self._size_bytes += len(text)
            self._unwritten.texts[report.report_id] = text
            self._make_room()
            self._synchronise()

    def batch(
        self, most_reports: int = MAX_REPORTS, *, only: Collection[UUID] = (), without: Collection[UUID] = ()
    ) -> list[Kept]:
        """Reports to be sent together, in the order in which they were put; at least one when one waits.

        Most of them the oldest, some the newest. `only`, when not empty, and `without` restrict the choice.
        """
        with self._lock:
            self._synchronise()
            within: Collection[UUID] = self._entries if self._is_readable() else self._unwritten.texts
            chosen = [i for i in within if i not in without and (not only or i in only)]
            wanted = _mixed(chosen, most_reports)
            # One byte more for the comma; JSON of reports is ASCII, since names are.
            sizes = accumulate(self._entries[i].size_bytes + 1 for i in wanted)
            going = set(wanted[: max(1, sum(size <= BATCH_BYTES for size in sizes))])
            kept = self._texts([i for i in chosen if i in going])
            if self.trouble is None:
                for lost in going - {item.report_id for item in kept}:
                    self._give_up(lost, LOST, "the outbox's file was broken")
            return kept

    def settle(self, results: Iterable[ReportResult]) -> None:
        """Forget reports that the server has answered for good; what it rejected is kept in `dropped`, with why."""
        with self._lock:
            for result in results:
                if result.report_id not in self._entries:
                    continue
                if result.status is ReportStatus.REJECTED:
                    self._note_dropped(result.report_id, f"rejected: {result.reason}")
                self._forget(result.report_id, result.status.value)
            self._synchronise()

    def drop(self, report_id: UUID, reason: str) -> None:
        """Give up a report that the server refuses."""
        with self._lock:
            if report_id in self._entries:
                self._note_dropped(report_id, reason)
                self._give_up(report_id, REFUSED, reason)
                self._synchronise()

    def take_given_up(self) -> list[ReportResult]:
        """Reports given up here since the last call, in the form of the server's rejections."""
        with self._lock:
            taken, self._given_up = self._given_up, []
            return taken

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            self._synchronise()
            self._is_closed = True
            self._file.close()

    def _is_readable(self) -> bool:
        try:
            self._file.read("SELECT 1 FROM report LIMIT 1")
        except DiskError:
            return False
        return True

    def _texts(self, report_ids: Sequence[UUID]) -> list[Kept]:
        """Those of the reports that can be read, with their texts."""
        texts = {i: self._unwritten.texts[i] for i in report_ids if i in self._unwritten.texts}
        stored = [str(i) for i in report_ids if i not in texts]
        marks = ",".join("?" * len(stored))
        try:
            rows = self._file.read(f"SELECT id, body FROM report WHERE id IN ({marks})", stored)  # noqa: S608
        except DiskError as error:
            self._tell(str(error))
            return [Kept(i, text) for i, text in texts.items()]
        texts |= {UUID(identifier): text for identifier, text in rows}
        return [Kept(i, texts[i]) for i in report_ids if i in texts]

    def _synchronise(self) -> None:
        """Bring the file up to date with memory; what it does not take now waits for the next call."""
        if self._is_closed:
            return
        try:
            if not self._is_read:
                self._read()
            if statements := self._unwritten.statements(self._entries):
                self._file.write(statements)
                self._tell(None)
        except DiskError as error:
            self._tell(str(error))
            return
        self._counts += self._unwritten.tally
        self._unwritten = _Unwritten()

    def _read(self) -> None:
        rows = self._file.read("SELECT id, length(body), sees FROM report ORDER BY position")
        stored = {UUID(identifier): _Entry(size_bytes, bool(sees)) for identifier, size_bytes, sees in rows}
        self._entries = stored | self._entries
        self._size_bytes = sum(entry.size_bytes for entry in self._entries.values())
        self._counts = Counter(dict(self._file.read("SELECT fate, number FROM tally")))
        self._is_read = True
        self._tell(None)

    def _make_room(self) -> None:
        while self._size_bytes > self._most_bytes and len(self._entries) > 1:
            self._give_up(self._least(self._entries), NO_ROOM, "the outbox is full")
        texts = self._unwritten.texts
        while sum(map(len, texts.values())) > MEMORY_BYTES and len(texts) > 1:
            self._give_up(self._least(texts), NO_ROOM, "the disk takes nothing, and the outbox's memory is full")

    def _least(self, report_ids: Collection[UUID]) -> UUID:
        """The oldest report without a detection; if there is none, the oldest."""
        return next((i for i in report_ids if not self._entries[i].sees), next(iter(report_ids)))

    def _note_dropped(self, report_id: UUID, reason: str) -> None:
        text = "".join(kept.body for kept in self._texts([report_id]))
        self._unwritten.dropped.append((str(report_id), reason, datetime.now(UTC).isoformat(), text))
        del self._unwritten.dropped[:-DROPPED_KEPT]
        _LOG.warning("report %s was dropped: %s", report_id, reason)

    def _give_up(self, report_id: UUID, fate: str, reason: str) -> None:
        self._given_up.append(ReportResult(report_id=report_id, status=ReportStatus.REJECTED, reason=reason))
        del self._given_up[:-GIVEN_UP_KEPT]
        self._forget(report_id, fate)

    def _forget(self, report_id: UUID, fate: str) -> None:
        self._size_bytes -= self._entries.pop(report_id).size_bytes
        # It may have reached the file although the write was said to have failed.
        self._unwritten.texts.pop(report_id, None)
        self._unwritten.settled.add(report_id)
        self._unwritten.tally[fate] += 1

    def _tell(self, trouble: str | None) -> None:
        if trouble is not None and self.trouble is None:
            _LOG.warning("the outbox is kept in memory, since the disk takes nothing: %s", trouble)
        if trouble is None and self.trouble is not None:
            _LOG.warning("the outbox is on disk again")
        self.trouble = trouble


def _mixed(oldest_first: Sequence[UUID], most: int) -> list[UUID]:
    """`most` of them: three from the old end for each one from the new end, in turns."""
    if len(oldest_first) <= most:
        return list(oldest_first)
    new = most // (OLD_TO_NEW + 1)
    old = iter(oldest_first[: most - new])
    newest = reversed(oldest_first[len(oldest_first) - new :])
    turns = zip_longest(*[old] * OLD_TO_NEW, newest)
    return [report_id for turn in turns for report_id in turn if report_id is not None]
