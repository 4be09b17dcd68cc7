"""What the parts of this process count, as plain numbers; `server.web.metrics` reads them when it is asked."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

from contract.observation import ReportResult, ReportStatus

GROUP_SIZES = (1, 2, 4, 8, 16, 32, 64)
# From a nearby query (0.2 ms) to the greatest deadline of a write that makes sense.
LATENCIES_S = (0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)


class Histogram:
    """Counts of values up to each bound, and beyond the last."""

    __slots__ = ("bounds", "counts", "total")

    def __init__(self, bounds: Sequence[float]) -> None:
        self.bounds = bounds
        self.counts = [0] * (len(bounds) + 1)
        self.total = 0.0

    def observe(self, value: float) -> None:
        """Count a value."""
        self.counts[bisect_left(self.bounds, value)] += 1
        self.total += value


@dataclass(slots=True)
class IngestCounts:
    """Reports on their way into the database."""

    reports: Counter[str] = field(default_factory=Counter)
    """By status."""
    decisions: Counter[str] = field(default_factory=Counter)
    """On detections, by kind."""
    inspections: Counter[str] = field(default_factory=Counter)
    """By what they did: `counted`, `removed` or `ignored`."""
    groups: Histogram = field(default_factory=lambda: Histogram(GROUP_SIZES))
    """Reports that shared a commit."""
    attempts_failed: int = 0
    """Transactions that were tried again."""

    def count(self, result: ReportResult) -> None:
        """Count an answer; what a repeated one says was counted when it was decided."""
        self.reports[result.status.value] += 1
        if result.status is not ReportStatus.ACCEPTED:
            return
        for detection in result.detections:
            self.decisions[detection.decision] += 1
        for inspection in result.inspections:
            self.inspections["removed" if inspection.removed else "counted" if inspection.counted else "ignored"] += 1


@dataclass(slots=True)
class NearbyCounts:
    """Nearby queries from memory."""

    queries: int = 0
    version_checks: int = 0
    """Statements that asked for versions of tiles; waiting queries share one."""
    tiles_fresh: int = 0
    """Tiles that were in memory at the right version."""
    tiles_changed: int = 0
    """Tiles that were brought up to date from the event log."""
    tiles_loaded: int = 0
    """Tiles that were read as a whole."""


@dataclass(slots=True)
class PushCounts:
    """Events, after the commit that caused them."""

    published: Counter[str] = field(default_factory=Counter)
    """By what happened: `changed`, or the reason of a removal."""
    sent: int = 0
    """Messages that went out on sockets."""
