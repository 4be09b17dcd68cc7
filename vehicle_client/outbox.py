"""Reports wait here, on disk, until the server has answered: SQLite, one row a report, oldest first."""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence
from datetime import UTC, datetime
from itertools import accumulate
from pathlib import Path
from uuid import UUID

import httpx
from pydantic import ValidationError

from contract.observation import (
    MAX_BODY_BYTES,
    MAX_REPORTS,
    ObservationBatch,
    ObservationBatchResult,
    ObservationReport,
    ReportResult,
    ReportStatus,
)

RETRIED = frozenset({408, 425, 429, 500, 502, 503, 504})
"""Statuses after which the same report is sent again; reports carry their own id, so that is harmless."""


BATCH_BYTES = MAX_BODY_BYTES - 1024
"""Reports of one batch together; the rest is for what the batch itself says."""


class OutboxError(RuntimeError):
    """The server refuses this vehicle, or the file is unusable; nothing is lost, the reports stay in the outbox."""


class Outbox:
    """A durable queue of reports. A report leaves it only when the server's answer says what became of it."""

    def __init__(self, path: Path | str) -> None:
        try:
            self._database = sqlite3.connect(path, isolation_level=None)
            self._database.execute("PRAGMA journal_mode=WAL")
            self._database.execute("PRAGMA synchronous=FULL")
            self._database.execute(
                "CREATE TABLE IF NOT EXISTS report"
                " (position INTEGER PRIMARY KEY, id TEXT UNIQUE NOT NULL, body TEXT NOT NULL)"
            )
        except sqlite3.DatabaseError as error:
            raise OutboxError(f"{path} cannot be the outbox: {error}; move it away or name another file") from error

    def put(self, report: ObservationReport) -> None:
        """Keep a report until it is answered; it is on disk when this returns."""
        self._database.execute(
            "INSERT OR IGNORE INTO report (id, body) VALUES (?, ?)", (str(report.report_id), report.model_dump_json())
        )

    def pending(self) -> list[ObservationReport]:
        """The oldest reports, as many as one batch may hold; the oldest one always."""
        rows = self._database.execute("SELECT body FROM report ORDER BY position LIMIT ?", (MAX_REPORTS,))
        bodies = [body for (body,) in rows]
        # One byte more for the comma; JSON of reports is ASCII, since names are.
        sizes = accumulate(len(body) + 1 for body in bodies)
        fitting = sum(size <= BATCH_BYTES for size in sizes)
        return [ObservationReport.model_validate_json(body) for body in bodies[: max(fitting, 1)]]

    def settle(self, report_ids: Sequence[UUID]) -> None:
        """Forget reports that the server has answered for good."""
        self._database.executemany("DELETE FROM report WHERE id = ?", [(str(i),) for i in report_ids])

    def close(self) -> None:
        """Close the file."""
        self._database.close()


def deliver(outbox: Outbox, client: httpx.Client) -> list[ReportResult]:
    """Send what waits, one batch; returns the answers that settled a report.

    What the network or the server did not answer stays for the next call: nothing is lost. Raises `OutboxError` when
    the server refuses the key or this kind of request, since sending again cannot help.
    """
    reports = outbox.pending()
    if not reports:
        return []
    batch = ObservationBatch(sent_at=datetime.now(UTC), reports=tuple(reports))
    try:
        response = client.post(
            "/v1/observations", content=batch.model_dump_json(), headers={"content-type": "application/json"}
        )
    except httpx.RequestError:
        return []
    if response.status_code in RETRIED:
        return []
    if response.status_code != httpx.codes.OK:
        raise OutboxError(f"the server answered {response.status_code}: {_detail(response)}")
    try:
        results = ObservationBatchResult.model_validate_json(response.content).results
    except ValidationError as error:
        raise OutboxError("the server's answer is not of this contract; are both of the same version?") from error
    settled = [r for r in results if r.status is not ReportStatus.RETRY]
    outbox.settle([r.report_id for r in settled])
    return settled


def _detail(response: httpx.Response) -> str:
    try:
        problem = response.json()
    except ValueError:
        return response.reason_phrase
    return str(problem.get("detail") or problem.get("title")) if isinstance(problem, dict) else response.reason_phrase
