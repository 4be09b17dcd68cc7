"""Reports on their way into PostgreSQL: a server with fsync and group commit against one that validates only."""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import replace
from datetime import UTC, datetime

from benchmarks.server_load import Cost, Load, LoadError, cost_of
from benchmarks.server_nearby import bare, serving
from benchmarks.server_processes import Measured
from benchmarks.server_queries import near_obstacles, write_queries
from benchmarks.server_report import Report, Row, Stock
from benchmarks.server_reports import FORMS, Form, write_bodies
from benchmarks.server_turns import bar

# Requests a second that are never reached: a body is sent once.
_MOST_PER_S = 12_000
# As many reports as wait at once are decided in one.
_SETTLED_S = 2.0
# A nearby query's answer, in which the aim is counted.
_GET_BYTES = 1_300


def run(stock: Stock, report: Report, rounds: int, seconds: int, seed: int) -> None:
    """Print a table for each form of request; the obstacles of `stock` are changed."""
    for number, form in enumerate(FORMS):
        title = f"Ingest, {form.name}, {form.connections} connections, for each report"
        try:
            bare_get, validating, service = _measured(stock, form, rounds, seconds, seed + 1_000 * number)
        except LoadError as error:
            report.note(f"{title}: not measured: {error}")
        else:
            report.costs(title, [validating, service], validating, service, form.reports)
            times = service.cpu_us / form.reports / bare_get.cpu_us
            waited_ms = service.middle(lambda cost: cost.p50_ms), service.middle(lambda cost: cost.p99_ms)
            report.note(
                f"A report costs {times:.1f} times the bare endpoint's {bare_get.cpu_us / 1e3:.3f} ms; "
                f"a request is answered after {waited_ms[0]:.0f} ms (median), {waited_ms[1]:.0f} ms (p99)."
            )


def _measured(stock: Stock, form: Form, rounds: int, seconds: int, seed: int) -> tuple[Row, Row, Row]:
    bare_get, validating, service = Row("bare endpoint", []), Row("validates only", []), Row("HeadsUp", [])
    with ExitStack() as stack:
        progress = stack.enter_context(bar())
        task = progress.add_task(f"ingest, {form.name}", total=1 + rounds)
        server = stack.enter_context(serving(stock))
        # Statements are made and prepared, and pages come into memory, as on a server that has been running.
        first = cost_of(server, _load(stock, form, seconds, seed), seconds)
        alone = stack.enter_context(bare(_GET_BYTES, int(first.answer_bytes) - 150))
        get = write_queries(stock.folder / "bare", near_obstacles(stock.places_deg, 1_000, seed))
        for turn in range(rounds):
            progress.advance(task)
            load = _load(stock, form, seconds, seed + 1 + turn)
            bare_get.costs.append(cost_of(alone, get, seconds))
            validating.costs.append(cost_of(alone, load, seconds))
            service.costs.append(_settled(server, load, seconds))
    return bare_get, validating, service


def _settled(server: Measured, load: Load, seconds: int) -> Cost:
    """What a load costs until all that was sent is decided: also the last request of each connection, which wrk ends.

    At 32 connections those are a tenth of what is answered in a few seconds.
    """
    before_s = server.cpu_s()
    cost = cost_of(server, load, seconds)
    time.sleep(_SETTLED_S)
    app_s, database_s = (after - before for after, before in zip(server.cpu_s(), before_s, strict=True))
    decided = cost.requests + load.connections
    return replace(cost, app_us=1e6 * app_s / decided, database_us=1e6 * database_s / decided)


def _load(stock: Stock, form: Form, seconds: int, seed: int) -> Load:
    """Bodies that were never sent to the service."""
    path = stock.folder / "bodies"
    weight = form.reports * (1 + form.detections * form.points // 100)
    write_bodies(path, form, seconds * _MOST_PER_S // (2 * weight) + 100, stock.places_deg, seed, datetime.now(UTC))
    return Load(path, posts=True, connections=form.connections)
