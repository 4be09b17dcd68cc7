"""Tables of the service's benchmark, and what they are made from."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.server_data import FloatArray
from benchmarks.server_load import Cost


@dataclass(frozen=True, slots=True)
class Stock:
    """A database and the places of the obstacles in it."""

    url: str
    database_pid: int
    places_deg: FloatArray
    folder: Path
    """Where the load's files go."""


@dataclass(frozen=True, slots=True)
class Row:
    """What one subject cost in each round."""

    name: str
    costs: list[Cost]

    def middle(self, figure: Callable[[Cost], float]) -> float:
        """Median of a figure over the rounds."""
        return median(map(figure, self.costs))

    @property
    def cpu_us(self) -> float:
        """Processor time of a request, server and database."""
        return self.middle(lambda cost: cost.cpu_us)

    @property
    def per_second(self) -> float:
        """Throughput."""
        return self.middle(lambda cost: cost.per_second)


@dataclass(slots=True)
class Report:
    """Prints tables in Markdown as they come, and keeps them with the figures of each round."""

    seed: int
    tables: list[dict[str, Any]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def note(self, text: str) -> None:
        """A line between the tables."""
        self.notes.append(text)
        print(f"\n{text}", flush=True)

    def costs(self, title: str, rows: Sequence[Row], bare: Row, own: Row, reports: int = 1) -> None:
        """Costs of a request, or of each of its `reports`, beside those of the framework alone and of the service."""
        self._begin(title, rows)
        _line(
            "",
            "CPU ms, server",
            "CPU ms, database",
            "a second",
            "bare's CPU / CPU",
            "a second / bare's",
            "CPU / HeadsUp's",
            "bytes",
        )
        _line(*["---"] * 8)
        for row in rows:
            _line(
                row.name,
                f"{row.middle(lambda cost: cost.app_us) / reports / 1e3:.3f}",
                f"{row.middle(lambda cost: cost.database_us) / reports / 1e3:.3f}",
                f"{row.per_second * reports:,.0f}",
                f"{bare.cpu_us / row.cpu_us:.3f}",
                f"{row.per_second / bare.per_second:.3f}",
                f"{row.cpu_us / own.cpu_us:.2f}",
                f"{row.middle(lambda cost: cost.answer_bytes):,.0f}",
            )

    def latencies(self, title: str, rows: Sequence[Row]) -> None:
        """Median and 99th percentile."""
        self._begin(title, rows)
        _line("", "a second", "p50 ms", "p99 ms", "p99 / p50")
        _line(*["---"] * 5)
        for row in rows:
            p50_ms, p99_ms = row.middle(lambda cost: cost.p50_ms), row.middle(lambda cost: cost.p99_ms)
            _line(row.name, f"{row.per_second:,.0f}", f"{p50_ms:.2f}", f"{p99_ms:.2f}", f"{p99_ms / p50_ms:.1f}")

    def write(self, path: Path) -> None:
        """All figures of all rounds as JSON."""
        said = {"machine": machine(), "seed": self.seed, "notes": self.notes, "tables": self.tables}
        path.write_text(json.dumps(said, indent=1) + "\n", encoding="utf-8")

    def _begin(self, title: str, rows: Sequence[Row]) -> None:
        self.tables.append(
            {
                "title": title,
                "rows": [{"name": row.name, "rounds": [asdict(cost) for cost in row.costs]} for row in rows],
            }
        )
        print(f"\n### {title}\n")


def machine() -> str:
    """What it runs on, and how busy that is."""
    load = os.getloadavg()[0]
    return f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}, load {load:.1f}"


def _line(*cells: str) -> None:
    print("| " + " | ".join(cells) + " |", flush=True)
