"""Turns: all that is compared is measured one after the other, again and again, so that other work falls on all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from rich.console import Console
from rich.progress import Progress

from benchmarks.server_load import Load, cost_of
from benchmarks.server_processes import Measured
from benchmarks.server_report import Row


@dataclass(frozen=True, slots=True)
class Subject:
    """A server and what it is asked."""

    name: str
    server: Measured
    load: Load

    def at(self, per_second: float) -> Subject:
        """The same at a pace."""
        return replace(self, load=self.load.at(per_second))


def in_turns(subjects: Sequence[Subject], rounds: int, seconds: int) -> list[Row]:
    """A row for each subject; each load goes on where it stopped."""
    rows = [Row(subject.name, []) for subject in subjects]
    with bar() as progress:
        task = progress.add_task("", total=rounds * len(subjects))
        for _ in range(rounds):
            for subject, row in zip(subjects, rows, strict=True):
                progress.update(task, description=subject.name)
                done = sum(cost.requests for cost in row.costs)
                row.costs.append(cost_of(subject.server, subject.load.beginning(done), seconds))
                progress.advance(task)
    return rows


def bar() -> Progress:
    """A progress bar that stays out of the tables."""
    return Progress(console=Console(stderr=True), transient=True)
