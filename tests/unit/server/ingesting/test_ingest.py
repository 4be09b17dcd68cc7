"""What ingest survives."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Sequence

import pytest

from contract.observation import ReportStatus
from server.ingesting import answers
from server.ingesting.group import Outcome, Outcomes
from server.ingesting.ingest import Ingest
from server.ingesting.parcel import Parcel
from server.storage.features import ObstacleEvent
from tests.unit.server.making import NOON, detection, message
from tests.unit.server.served import feature


def _parcel(number: int) -> Parcel:
    sent = message(detection(), number=number)
    return Parcel(sent, NOON, NOON, "key", sent.pseudonym, sent.model_dump_json())


async def _committed(parcels: Sequence[Parcel]) -> Outcomes:
    event = ObstacleEvent.of(feature())
    return [Outcome(answers.accepted(item.message, []), (event,)) for item in parcels]


def _fail(_event: ObstacleEvent) -> None:
    raise RuntimeError("a listener is broken")


async def test_a_listener_that_fails_costs_no_sender_the_answer_and_does_not_end_ingest(
    caplog: pytest.LogCaptureFixture,
) -> None:
    ingest = Ingest(_committed, deadline_s=5, publish=_fail)
    worker = asyncio.create_task(ingest.run())
    try:
        with caplog.at_level(logging.ERROR):
            first = await ingest.take([_parcel(1), _parcel(2)])
            second = await ingest.take([_parcel(3)])
    finally:
        worker.cancel()
        await asyncio.gather(worker, return_exceptions=True)
    assert [result.status for result in first + second] == [ReportStatus.ACCEPTED] * 3
    assert caplog.text.count("reached nobody at this server") == 3
