"""Reports on their way into PostgreSQL: a server with fsync and group commit against one that validates only."""

from __future__ import annotations

from contextlib import ExitStack
from datetime import UTC, datetime

from benchmarks.server_load import Load, cost_of
from benchmarks.server_nearby import bare, serving
from benchmarks.server_report import Row, Stock, print_costs
from benchmarks.server_reports import FORMS, Form, write_bodies

_CONNECTIONS = 64
# Requests a second that are never reached: a body is sent once.
_MOST_PER_S = 12_000


def run(stock: Stock, rounds: int, seconds: int, seed: int) -> None:
    """Print a table for each form of request."""
    for number, form in enumerate(FORMS):
        _print_form(stock, form, rounds, seconds, seed + 1_000 * number)


def _print_form(stock: Stock, form: Form, rounds: int, seconds: int, seed: int) -> None:
    service, validating = Row("service", []), Row("validates only", [])
    with ExitStack() as stack:
        server = stack.enter_context(serving(stock))
        first = cost_of(server, _load(stock, form, 2, seed), 2)
        alone = stack.enter_context(bare(200, int(first.answer_bytes) - 150))
        for turn in range(rounds):
            load = _load(stock, form, seconds, seed + 1 + turn)
            validating.costs.append(cost_of(alone, load, seconds))
            service.costs.append(cost_of(server, load, seconds))
    print_costs(f"Ingest, {form.name}, {_CONNECTIONS} connections", [validating, service], validating, form.reports)


def _load(stock: Stock, form: Form, seconds: int, seed: int) -> Load:
    """Bodies that were never sent to the service."""
    path = stock.folder / "bodies"
    weight = form.reports * (1 + form.detections * form.points // 100)
    write_bodies(path, form, seconds * _MOST_PER_S // (2 * weight) + 100, stock.places_deg, seed, datetime.now(UTC))
    return Load(path, posts=True, connections=_CONNECTIONS)
