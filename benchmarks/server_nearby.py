"""Nearby queries: a server process beside a bare endpoint and its peers, few and many obstacles, warm and cold."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path

from benchmarks.peer_beside import Beside, peers_beside
from benchmarks.server_answers import comparison, found_by
from benchmarks.server_data import RADIUS_M, FloatArray
from benchmarks.server_load import Load, cost_of
from benchmarks.server_processes import SERVE, Measured, listening
from benchmarks.server_queries import (
    KEY,
    PathOf,
    box_path,
    circle_path,
    filtered_path,
    near_obstacles,
    one_in_each_tile,
    write_queries,
)
from benchmarks.server_report import Report, Stock
from benchmarks.server_turns import Subject, bar, in_turns

REPEATED, FRESH = 1_000, 400_000
# Whatever does not answer from memory gets through a fraction of them.
_FRESH_BY_SQL = 60_000
# A million obstacles in memory, and room.
_CACHE_MIB = "4096"
_REPEATED, _FRESH = f"{REPEATED:,} places", "never the same place"


def serving(stock: Stock, key: str = "") -> AbstractContextManager[Measured]:
    """`headsup serve` on a database, with one key that stands for a whole fleet, or open."""
    environment = {"HEADSUP_DATABASE_URL": stock.url, "HEADSUP_CACHE_MIB": _CACHE_MIB, "HEADSUP_LOG_LEVEL": "error"}
    if key:
        environment |= {"HEADSUP_BOOTSTRAP_OPERATOR_KEY": key, "HEADSUP_OPERATOR_RATE_HZ": "1e9"}
    return listening(SERVE, environment, stock.database_pid)


def bare(get_bytes: int, post_bytes: int = 200) -> AbstractContextManager[Measured]:
    """The framework alone, with answers of these sizes."""
    return listening((sys.executable, "-m", "benchmarks.server_bare", str(get_bytes), str(post_bytes)), {})


class _Queries:
    """Files of the same places for servers with different paths."""

    def __init__(self, stock: Stock, seed: int) -> None:
        self._folder = stock.folder
        self._repeated = near_obstacles(stock.places_deg, REPEATED, seed)
        self._fresh = near_obstacles(stock.places_deg, FRESH, seed + 1)
        self._cold = near_obstacles(stock.places_deg, _FRESH_BY_SQL, seed + 2)

    def repeated(self, name: str, path_of: PathOf = circle_path) -> Load:
        """A thousand places again and again."""
        return self._written(f"{name}-repeated", self._repeated, path_of)

    def fresh(self, name: str, path_of: PathOf = circle_path, number: int = FRESH) -> Load:
        """Each place once."""
        return self._written(f"{name}-fresh", self._fresh[:number], path_of)

    def cold(self, name: str, path_of: PathOf = circle_path) -> Load:
        """Other places, each once."""
        return self._written(f"{name}-cold", self._cold, path_of)

    def _written(self, name: str, places_deg: FloatArray, path_of: PathOf) -> Load:
        return write_queries(self._folder / name, places_deg, path_of)


def run(few: Stock, many: Stock, peers: Path | None, report: Report, rounds: int, seconds: int, seed: int) -> None:
    """Print the tables."""
    queries = _Queries(many, seed)
    with ExitStack() as stack:
        large = stack.enter_context(serving(many, KEY))
        beside = stack.enter_context(peers_beside(peers, many, report))
        cold = in_turns(_cold(large, beside, queries), 1, seconds)
        _warm(large, many, report)
        own = _own(large, queries)
        size = _body_bytes(cost_of(large, own[0].load, 3).answer_bytes)
        framework = stack.enter_context(bare(size))
        subjects = [
            Subject("bare endpoint, answers of the same size", framework, own[0].load),
            *own,
            _small(stack.enter_context(serving(few, KEY)), few, seed),
            *_of_peers(beside, queries),
        ]
        rows = in_turns(subjects, rounds, seconds)
        title = f"Nearby, {RADIUS_M:.0f} m, {len(many.places_deg):,} obstacles, one process of each server"
        report.costs(title, [*rows, *cold], bare=rows[0], own=rows[2])
        growth = rows[1].cpu_us / rows[1 + len(own)].cpu_us
        report.note(f"{len(many.places_deg):,} obstacles cost {growth:.2f} times what {len(few.places_deg):,} do.")
        _compare([subject for subject in subjects if subject.name.endswith(_FRESH)], report)
        paced = [subject.at(row.per_second / 2) for subject, row in zip(subjects, rows, strict=True)]
        report.latencies("Nearby, at half of what each can do", in_turns(paced, 1, 2 * seconds))


def _own(server: Measured, queries: _Queries) -> list[Subject]:
    box = queries.fresh("box", box_path, _FRESH_BY_SQL)
    return [
        Subject(f"HeadsUp, {_REPEATED}", server, queries.repeated("own")),
        Subject(f"HeadsUp, {_FRESH}", server, queries.fresh("own")),
        Subject(f"HeadsUp, filtered, {_FRESH}", server, queries.fresh("filtered", filtered_path)),
        Subject(f"HeadsUp, a box, {_FRESH}", server, box),
    ]


def _small(server: Measured, few: Stock, seed: int) -> Subject:
    load = write_queries(few.folder / "few", near_obstacles(few.places_deg, REPEATED, seed))
    cost_of(server, load, 3)
    return Subject(f"HeadsUp, {len(few.places_deg):,} obstacles, {_REPEATED}", server, load)


def _of_peers(beside: Sequence[Beside], queries: _Queries) -> Iterator[Subject]:
    for item in beside:
        yield Subject(f"{item.peer.name}, {_REPEATED}", item.server, queries.repeated(*_form(item)))
        yield Subject(f"{item.peer.name}, {_FRESH}", item.server, queries.fresh(*_form(item), number=_FRESH_BY_SQL))


def _cold(server: Measured, beside: Sequence[Beside], queries: _Queries) -> list[Subject]:
    """Each as it was started: HeadsUp reads tiles for every query, PostGIS its pages."""
    peers = (Subject(f"{item.peer.name}, cold", item.server, queries.cold(*_form(item))) for item in beside)
    return [Subject("HeadsUp, cold", server, queries.cold("own")), *peers]


def _compare(subjects: Sequence[Subject], report: Report) -> None:
    """All were asked about the same places."""
    report.note(comparison([(subject.name.removesuffix(f", {_FRESH}"), found_by(subject)) for subject in subjects]))


def _form(item: Beside) -> tuple[str, PathOf]:
    """Name of a peer's files, and its paths."""
    return item.peer.package, item.peer.path_of


def _warm(server: Measured, stock: Stock, report: Report) -> None:
    """Touch every tile."""
    places_deg = one_in_each_tile(stock.places_deg)
    tour, tiles, done = write_queries(stock.folder / "tour", places_deg), len(places_deg), 0
    with bar() as progress:
        task = progress.add_task("every tile into memory", total=tiles)
        while done < tiles:
            done += cost_of(server, tour.beginning(done), 5).requests
            progress.update(task, completed=done)
    report.note(f"HeadsUp with all {tiles:,} tiles in memory: {server.resident_mib:,.0f} MiB.")


def _body_bytes(answer_bytes: float) -> int:
    """Without the headers, of which ours has some 400 bytes and the bare one 150: both answers are of one size."""
    return int(answer_bytes) - 150
