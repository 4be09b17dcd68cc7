"""Tables of the service's benchmark, and what they are made from."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

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


def print_costs(title: str, rows: Sequence[Row], bare: Row, reports: int = 1) -> None:
    """Costs of a request, or of each of its `reports`, and ratios to `bare`: more is better."""
    print(f"\n### {title}\n")
    print("| | CPU us, server | CPU us, database | a second | bare's CPU / CPU | throughput / bare's | bytes |")
    print("|---|---|---|---|---|---|---|")
    for row in rows:
        cells = (
            f"{row.middle(lambda cost: cost.app_us) / reports:.0f}",
            f"{row.middle(lambda cost: cost.database_us) / reports:.0f}",
            f"{row.per_second * reports:,.0f}",
            f"{bare.cpu_us / row.cpu_us:.2f}",
            f"{row.per_second / bare.per_second:.2f}",
            f"{row.middle(lambda cost: cost.answer_bytes):,.0f}",
        )
        print(f"| {row.name} | " + " | ".join(cells) + " |", flush=True)


def print_latencies(title: str, rows: Sequence[Row]) -> None:
    """Median and 99th percentile."""
    print(f"\n### {title}\n")
    print("| | a second | p50 ms | p99 ms | p99 / p50 |\n|---|---|---|---|---|")
    for row in rows:
        p50_ms, p99_ms = row.middle(lambda cost: cost.p50_ms), row.middle(lambda cost: cost.p99_ms)
        print(
            f"| {row.name} | {row.per_second:,.0f} | {p50_ms:.2f} | {p99_ms:.2f} | {p99_ms / p50_ms:.1f} |", flush=True
        )
