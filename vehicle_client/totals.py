"""What a drive came to, in numbers: what was found, what was told, and how late. Bounded, however long the drive."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from contract.observation import ReportResult, ReportStatus
from vehicle_client.alerts import Alerts, Stage
from vehicle_client.drive import Measured, Step
from vehicle_client.moments import Moment, why_untold

LATEST_MS = 10_000
"""Whoever hears of an obstacle later has passed it; later counts as this."""


@dataclass(slots=True)
class Latency:
    """How long after a sweep was complete the driver's alerts were known: a count for each millisecond."""

    counts: NDArray[np.int64] = field(default_factory=lambda: np.zeros(LATEST_MS + 1, dtype=np.int64))

    def observe(self, seconds: float) -> None:
        """Count one."""
        self.counts[min(max(int(1000 * seconds), 0), LATEST_MS)] += 1

    def percentile_ms(self, percent: float) -> float | None:
        """Milliseconds that so many per cent do not exceed; None before the first."""
        total = int(self.counts.sum())
        if not total:
            return None
        return float(np.searchsorted(np.cumsum(self.counts), percent / 100 * total) + 1)


@dataclass(slots=True)
class Totals:
    """Counts of one drive. Detections, tracks and reports count apart: no false alarm must not come from a refusal."""

    frames: int = 0
    unusable: int = 0
    """Frames whose points cannot be a sweep."""
    faults: int = 0
    """Frames in which the program failed."""
    broken_off: str | None = None
    """Why the source could not be read to its end."""
    no_road: int = 0
    """Frames that show no road: that nothing is found there says nothing."""
    placed: int = 0
    """Frames with a place in the world that may be reported and shown."""
    reasons: Counter[str] = field(default_factory=Counter)
    """Why the others had none, with N for each number."""
    detections: int = 0
    """Obstacles in single sweeps, each time one was seen."""
    found: int = 0
    """Obstacles in the last sweeps together, each time one was seen."""
    tracks: int = 0
    """Obstacles that were believed: seen in several frames."""
    moving: int = 0
    """Of those, what moved: never reported."""
    measured: Counter[str] = field(default_factory=Counter)
    """Obstacles that were measured after they were passed (or at the end), by kind; those that nobody is told of by the
    reason (`moments.why_untold`)."""
    reports: int = 0
    reported: int = 0
    """Detections in reports."""
    inspected: Counter[str] = field(default_factory=Counter)
    """Inspections in reports, by outcome."""
    answers: Counter[str] = field(default_factory=Counter)
    """Reports that were answered, by status."""
    refusals: Counter[str] = field(default_factory=Counter)
    """Of those, what was rejected, by reason: the server's code, or why it was given up here."""
    warned: int = 0
    """Obstacles that the driver was warned of."""
    latency: Latency = field(default_factory=Latency)
    _believed: frozenset[int] = frozenset()
    _moving: frozenset[int] = frozenset()
    _warned: frozenset[str] = frozenset()

    def add(self, step: Step) -> None:
        """Count a frame."""
        self.frames += 1
        self.no_road += not step.detection.road_seen
        self.placed += step.reported_pose is not None
        if step.reason is not None:
            # A car that stands in a garage for a month would have a reason of its own for each second.
            self.reasons[re.sub(r"\d+", "N", step.reason)] += 1
        self.detections += len(step.detection.obstacles)
        self.found += len(step.found)
        believed = frozenset(t.track_id for t in step.tracks if t.confirmed)
        moving = frozenset(t.track_id for t in step.tracks if t.confirmed and not t.is_static)
        # What is no longer near the car is forgotten: its number never comes back.
        self.tracks += len(believed - self._believed)
        self.moving += len(moving - self._moving)
        self._believed, self._moving = believed, (self._moving | moving) & believed
        if step.pose is not None:
            # Of a frame without a place nothing is shown, and nothing is passed: what comes after is no new warning.
            self._add_warned(step.alerts)
        self.add_told(step)

    def add_told(self, step: Step) -> None:
        """Count what a step measured, told and heard; all that the end of a drive brings."""
        self.measured.update(_kind(m) for m in step.measured if m.due.moment is not Moment.APPROACH)
        self.reports += len(step.reports)
        self.reported += sum(len(report.detections) for report in step.reports)
        self.inspected.update(i.outcome.value for report in step.reports for i in report.inspections)
        self.add_answers(answer.result for answer in step.answers)

    def add_answers(self, results: Iterable[ReportResult]) -> None:
        """Count what became of reports."""
        for result in results:
            self.answers[result.status.value] += 1
            if result.status is ReportStatus.REJECTED:
                # What follows a colon is about one report, and in the log.
                self.refusals[(result.reason or "no reason given").partition(":")[0]] += 1

    def _add_warned(self, shown: Alerts) -> None:
        warned = [hazard.keys for hazard in shown.hazards if hazard.stage >= Stage.WARN]
        self.warned += sum(not self._warned.intersection(keys) for keys in warned)
        self._warned = self._warned.intersection(shown.stages).union(*warned)

    def as_json(self) -> dict[str, Any]:
        """All counts, and the latency's percentiles."""
        names = (
            "frames",
            "unusable",
            "faults",
            "broken_off",
            "no_road",
            "placed",
            "detections",
            "found",
            "tracks",
            "moving",
            "reports",
        )
        counted = {name: getattr(self, name) for name in (*names, "reported", "warned")}
        by_name = ("reasons", "measured", "inspected", "answers", "refusals")
        latency = {f"p{percent}_ms": self.latency.percentile_ms(percent) for percent in (50, 95, 99)}
        return counted | {name: dict(getattr(self, name)) for name in by_name} | {"stamp_to_alert": latency}


def _kind(measured: Measured) -> str:
    track = measured.due.track
    return why_untold(track, measured.obstacle) or track.kind.value
