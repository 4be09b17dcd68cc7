"""Nearby queries: one server process against a bare endpoint, over few and over many obstacles, warm and cold."""

from __future__ import annotations

import sys
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path

import numpy as np

from benchmarks.server_data import RADIUS_M, FloatArray
from benchmarks.server_load import Load, cost_of
from benchmarks.server_processes import SERVE, Measured, listening
from benchmarks.server_report import Row, Stock, print_costs, print_latencies
from contract.geometry import LatLon
from server.quadkey import cell_of, tile_of_cell

REPEATED, FRESH = 1_000, 400_000
# A million obstacles in memory, and room.
_CACHE_MIB = "4096"
_NEAR_DEG = 2e-4
_KEY = "an-operator-key-of-the-benchmark-only"


def write_queries(path: Path, places_deg: FloatArray, number: int, seed: int) -> Load:
    """Circles about places some metres from random obstacles."""
    rng = np.random.default_rng(seed)
    places = places_deg[rng.integers(len(places_deg), size=number)] + rng.normal(0.0, _NEAR_DEG, (number, 2))
    return _written(path, places)


def write_tour(path: Path, places_deg: FloatArray) -> tuple[Load, int]:
    """One circle in every tile that holds an obstacle, and how many they are."""
    tiles: dict[int, tuple[float, float]] = {}
    for latitude_deg, longitude_deg in places_deg.tolist():
        place = LatLon(latitude_deg=latitude_deg, longitude_deg=longitude_deg)
        tiles.setdefault(tile_of_cell(cell_of(place)), (latitude_deg, longitude_deg))
    return _written(path, np.array(list(tiles.values()))), len(tiles)


def serving(stock: Stock, key: str = "") -> AbstractContextManager[Measured]:
    """`headsup serve` on a database, with one key that stands for a whole fleet, or open."""
    environment = {"HEADSUP_DATABASE_URL": stock.url, "HEADSUP_CACHE_MIB": _CACHE_MIB, "HEADSUP_LOG_LEVEL": "error"}
    if key:
        environment |= {"HEADSUP_BOOTSTRAP_OPERATOR_KEY": key, "HEADSUP_OPERATOR_RATE_HZ": "1e9"}
    return listening(SERVE, environment, stock.database_pid)


def bare(get_bytes: int, post_bytes: int = 200) -> AbstractContextManager[Measured]:
    """The framework alone, with answers of these sizes."""
    return listening((sys.executable, "-m", "benchmarks.server_bare", str(get_bytes), str(post_bytes)), {})


def run(few: Stock, many: Stock, rounds: int, seconds: int, seed: int) -> None:
    """Print the tables."""
    repeated = write_queries(many.folder / "repeated", many.places_deg, REPEATED, seed)
    fresh = write_queries(many.folder / "fresh", many.places_deg, FRESH, seed + 1)
    few_repeated = write_queries(few.folder / "few", few.places_deg, REPEATED, seed)
    tour, tiles = write_tour(many.folder / "tour", many.places_deg)
    with ExitStack() as stack:
        small = stack.enter_context(serving(few, _KEY))
        large = stack.enter_context(serving(many, _KEY))
        cold = cost_of(large, fresh, seconds)
        _warm(large, tour, tiles)
        cost_of(small, few_repeated, 3)
        size = cost_of(large, repeated, 3).answer_bytes
        alone = stack.enter_context(bare(_body_bytes(size)))
        subjects = {
            "bare endpoint": (alone, repeated),
            f"{len(many.places_deg):,} obstacles, {REPEATED:,} places": (large, repeated),
            f"{len(many.places_deg):,} obstacles, never the same place": (large, fresh),
            f"{len(few.places_deg):,} obstacles, {REPEATED:,} places": (small, few_repeated),
        }
        rows = in_turns(subjects, rounds, seconds)
        rows.insert(3, Row(f"{len(many.places_deg):,} obstacles, cold, never the same place", [cold]))
        print_costs(f"Nearby, {RADIUS_M:.0f} m, one server process", rows, rows[0])
        print(f"server with all tiles in memory: {large.resident_mib:,.0f} MiB, {tiles:,} tiles")
        _print_paced(subjects, rows, seconds)


def in_turns(subjects: dict[str, tuple[Measured, Load]], rounds: int, seconds: int) -> list[Row]:
    """All subjects one after the other, again and again; each load goes on where it stopped."""
    rows = {name: Row(name, []) for name in subjects}
    for _ in range(rounds):
        for name, (server, load) in subjects.items():
            done = sum(cost.requests for cost in rows[name].costs)
            rows[name].costs.append(cost_of(server, load.beginning(done), seconds))
    return list(rows.values())


def _print_paced(subjects: dict[str, tuple[Measured, Load]], rows: list[Row], seconds: int) -> None:
    """Latencies at half of what each can do, in turns."""
    able = {row.name: row.per_second for row in rows}
    paced = {name: (server, load.at(able[name] / 2)) for name, (server, load) in subjects.items()}
    print_latencies("At half the saturation load", in_turns(paced, 1, 2 * seconds))


def _warm(server: Measured, tour: Load, tiles: int) -> None:
    """Touch every tile."""
    done = 0
    while done < tiles:
        done += cost_of(server, tour.beginning(done), 5).requests


def _written(path: Path, places: FloatArray) -> Load:
    lines = (f"/v1/obstacles?lat={lat:.7f}&lon={lon:.7f}&radius_m={RADIUS_M:.0f}\n" for lat, lon in places.tolist())
    path.write_text("".join(lines), encoding="ascii")
    return Load(path, key=_KEY)


def _body_bytes(answer_bytes: float) -> int:
    """Without the headers, of which ours has some 400 bytes and the bare one 150: both answers are of one size."""
    return int(answer_bytes) - 150
