"""Vehicles that report to servers which may be killed: they send a report again until it is answered."""

from __future__ import annotations

import asyncio
import random
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta

import httpx

from contract.geometry import LatLon
from contract.observation import ObservationBatch, ObservationBatchResult, ObservationReport, ReportResult, ReportStatus
from tests.unit.server.making import PATRAS, detection, message

JSON = {"Content-Type": "application/json"}
# Spots far enough apart that none is taken for another.
_SPOTS = [(40.0 * east, 40.0 * north) for east in (-1, 0, 1) for north in (-1, 0, 1)]


def fleet_reports(seed: int, number: int, centre: LatLon = PATRAS) -> list[ObservationReport]:
    """Reports of one detection each, every one of another vehicle, about nine holes."""
    chance = random.Random(seed)  # noqa: S311
    now = datetime.now(UTC)
    reports = []
    for index in range(number):
        east_m, north_m = chance.choice(_SPOTS)
        seen = detection(east_m + chance.gauss(0, 0.2), north_m + chance.gauss(0, 0.2))
        at = now - timedelta(seconds=chance.uniform(60, 40 * 3600))
        reports.append(message(seen, vehicle=f"v{seed}-{index}", at=at, number=index, position=centre))
    return reports


@dataclass
class Tally:
    """What the vehicles were told: answers by report id, as if it was accepted just then, and every status."""

    answers: dict[str, ReportResult] = field(default_factory=dict)
    accepted: Counter[str] = field(default_factory=Counter)
    statuses: Counter[int | str] = field(default_factory=Counter)
    slowest_s: float = 0.0


async def send(client: httpx.AsyncClient, report: ObservationReport, tally: Tally) -> ReportResult | None:
    """One attempt; None when there was no answer that settles the report."""
    body = ObservationBatch(sent_at=datetime.now(UTC), reports=(report,)).model_dump_json()
    begun_s = asyncio.get_running_loop().time()
    try:
        answer = await client.post("/v1/observations", content=body, headers=JSON)
    except httpx.TransportError as error:
        tally.statuses[type(error).__name__] += 1
        return None
    tally.slowest_s = max(tally.slowest_s, asyncio.get_running_loop().time() - begun_s)
    tally.statuses[answer.status_code] += 1
    if answer.status_code != 200:
        assert_is_a_polite_refusal(answer)
        return None
    (result,) = ObservationBatchResult.model_validate_json(answer.content).results
    if result.status is ReportStatus.RETRY:
        return None
    name = str(report.report_id)
    tally.accepted[name] += result.status is ReportStatus.ACCEPTED
    assert tally.accepted[name] <= 1, "a report was accepted twice"
    # Of two that were sent at once, the repetition may be answered first.
    told = result.model_copy(update={"status": ReportStatus.ACCEPTED})
    assert tally.answers.setdefault(name, told) == told, "a repetition was answered otherwise"
    assert result.status in (ReportStatus.ACCEPTED, ReportStatus.DUPLICATE), result.reason
    return result


def assert_is_a_polite_refusal(answer: httpx.Response) -> None:
    assert answer.status_code == 503, f"{answer.status_code}: {answer.text}"
    assert answer.headers["content-type"] == "application/problem+json"
    assert int(answer.headers["retry-after"]) >= 1


async def settle(
    clients: Sequence[httpx.AsyncClient], reports: Sequence[ObservationReport], writers: int, tally: Tally
) -> None:
    """Send all reports, by so many writers at once, each again until it is answered, at the servers in turn."""
    waiting = list(enumerate(reports))[::-1]

    async def writer() -> None:
        while waiting:
            index, report = waiting.pop()
            for attempt in range(400):
                if await send(clients[(index + attempt) % len(clients)], report, tally) is not None:
                    break
                await asyncio.sleep(0.05)
            else:
                raise AssertionError(f"report {report.report_id} was never answered: {tally.statuses}")

    await asyncio.gather(*(writer() for _ in range(writers)))
