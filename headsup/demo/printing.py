"""What the demo says in the terminal: a progress bar a car, then the table of decisions and of leads."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from headsup.demo.simulated import SimulatedSource
from headsup.demo.summary import Summary
from vehicle_client.sources.frame import LidarFrame

STYLES = {"created": "green", "kept": "cyan", "updated": "yellow", "removed": "magenta", "rejected": "red"}


class Reporter:
    """Progress of the drives while inside, the tables at the end."""

    def __init__(self, tasks: Sequence[str]) -> None:
        self._console = Console()
        self._progress = Progress(
            TextColumn("{task.description:>5}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            console=self._console,
        )
        self._tasks = {name: self._progress.add_task(name, total=None, start=False) for name in tasks}

    def __enter__(self) -> Reporter:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()

    def track(self, source: SimulatedSource, car: str) -> Iterator[LidarFrame]:
        """The frames of a source, with the car's bar moving along."""
        task = self._tasks[car]
        self._progress.update(task, total=len(source))
        self._progress.start_task(task)
        for frame in source:
            yield frame
            self._progress.advance(task)

    def progress(self, task_name: str, done: int, total: int) -> None:
        """Set a bar."""
        self._progress.start_task(self._tasks[task_name])
        self._progress.update(self._tasks[task_name], completed=done, total=total)

    def show(self, summary: Summary, out: Path) -> None:
        """The two tables and where the report lies."""
        self._console.print(_decisions(summary))
        self._console.print(_leads(summary))
        self._console.print(f"report: {out / 'report.html'}", highlight=False)


def _decisions(summary: Summary) -> Table:
    table = Table(title="What the server decided", title_justify="left")
    for column in ("car", "obstacle", "decision", "version", "state", "detail"):
        table.add_column(column, overflow="fold")
    for row in summary.decisions:
        style = STYLES.get(row.decision, "dim")
        version = "" if row.version is None else str(row.version)
        table.add_row(row.car, row.obstacle, f"[{style}]{row.decision}[/]", version, row.state, row.detail)
    return table


def _leads(summary: Summary) -> Table:
    table = Table(title="How far ahead ego2 was warned", title_justify="left")
    for column in ("obstacle", "warned at", "before arrival", "own LiDAR at", "lead"):
        table.add_column(column, justify="left" if column == "obstacle" else "right")
    for w in summary.warnings:
        table.add_row(
            w.obstacle,
            f"{w.warned_distance_m:.0f} m",
            f"{w.warned_before_arrival_s:.1f} s",
            f"{w.seen_distance_m:.0f} m",
            f"{w.lead_m:.0f} m, {w.lead_s:.1f} s",
        )
    return table
