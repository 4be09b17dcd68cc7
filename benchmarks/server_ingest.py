"""Reports on their way into PostgreSQL: a server with fsync and group commit against one that validates only."""

from __future__ import annotations

from contextlib import ExitStack
from datetime import UTC, datetime

from benchmarks.server_load import Load, LoadError, cost_of
from benchmarks.server_nearby import bare, serving
from benchmarks.server_report import Report, Row, Stock
from benchmarks.server_reports import FORMS, Form, write_bodies
from benchmarks.server_turns import bar

# More would wait for longer than the service lets a report wait before it answers 503.
_AT_ONCE = 64
# Requests a second that are never reached: a body is sent once.
_MOST_PER_S = 12_000


def run(stock: Stock, report: Report, rounds: int, seconds: int, seed: int) -> None:
    """Print a table for each form of request; the obstacles of `stock` are changed."""
    for number, form in enumerate(FORMS):
        title = f"Ingest, {form.name}, {_connections(form)} connections, for each report"
        try:
            validating, service = _measured(stock, form, rounds, seconds, seed + 1_000 * number)
        except LoadError as error:
            report.note(f"{title}: not measured: {error}")
        else:
            report.costs(title, [validating, service], validating, service, form.reports)


def _connections(form: Form) -> int:
    """Two for each of wrk's threads at least."""
    return max(4, _AT_ONCE // form.reports)


def _measured(stock: Stock, form: Form, rounds: int, seconds: int, seed: int) -> tuple[Row, Row]:
    validating, service = Row("validates only", []), Row("HeadsUp", [])
    with ExitStack() as stack:
        progress = stack.enter_context(bar())
        task = progress.add_task(f"ingest, {form.name}", total=1 + rounds)
        server = stack.enter_context(serving(stock))
        # Statements are made and prepared, and pages come into memory, as on a server that has been running.
        first = cost_of(server, _load(stock, form, seconds, seed), seconds)
        alone = stack.enter_context(bare(200, int(first.answer_bytes) - 150))
        for turn in range(rounds):
            progress.advance(task)
            load = _load(stock, form, seconds, seed + 1 + turn)
            validating.costs.append(cost_of(alone, load, seconds))
            service.costs.append(cost_of(server, load, seconds))
    return validating, service


def _load(stock: Stock, form: Form, seconds: int, seed: int) -> Load:
    """Bodies that were never sent to the service."""
    path = stock.folder / "bodies"
    weight = form.reports * (1 + form.detections * form.points // 100)
    write_bodies(path, form, seconds * _MOST_PER_S // (2 * weight) + 100, stock.places_deg, seed, datetime.now(UTC))
    return Load(path, posts=True, connections=_connections(form))
