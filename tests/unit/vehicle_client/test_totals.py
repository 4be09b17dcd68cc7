"""What a drive came to: what was measured, by what it is."""

from __future__ import annotations

from dataclasses import replace
from uuid import UUID

import pytest

from contract.observation import ReportResult, ReportStatus
from detector.types import ObstacleKind
from tests.unit.vehicle_client.making import seen, track_at
from tests.unit.vehicle_client.test_drive import CALIBRATION, HeldLink, frame_at
from vehicle_client.drive import Measured, Vehicle
from vehicle_client.moments import Due, Moment
from vehicle_client.totals import Totals


def test_posts_beside_the_lane_are_counted_as_such_and_not_as_debris() -> None:
    """Three bollards of a recorded street looked like three obstacles that were never reported."""
    bollard = replace(seen(kind=ObstacleKind.DEBRIS, length_m=0.25, width_m=0.2), relief_m=0.5)
    tyre = replace(bollard, relief_m=0.2)
    beside = replace(track_at(-12.0, 3.0, kind=ObstacleKind.DEBRIS), beside_m=3.0)
    step = Vehicle(CALIBRATION, HeldLink(), pseudonym="car").step(frame_at(0.0, 0.0))
    measured = (
        Measured(Due(beside, Moment.APPROACH), bollard, False),
        Measured(Due(beside, Moment.PASSED), bollard, False),
        Measured(Due(beside, Moment.END), tyre, True),
    )
    totals = Totals()
    totals.add(replace(step, measured=measured))
    assert totals.measured == {"post": 1, "debris": 1}


@pytest.mark.parametrize(
    ("reasons", "refusals"),
    [
        ([], {}),
        (["too-old", "impossible-speed", "too-old"], {"too-old": 2, "impossible-speed": 1}),
        (["withheld: quiet zone"], {"withheld": 1}),
        (["422: 3 reports of v-17", "422: 1 report of v-18"], {"422": 2}),
        ([None], {"no reason given": 1}),
    ],
)
def test_rejected_reports_are_counted_by_why_and_not_one_by_one(
    reasons: list[str | None], refusals: dict[str, int]
) -> None:
    taken = ReportResult(report_id=UUID(int=1), status=ReportStatus.ACCEPTED)
    rejected = [ReportResult(report_id=UUID(int=2), status=ReportStatus.REJECTED, reason=reason) for reason in reasons]
    totals = Totals()
    totals.add_answers([taken, *rejected])
    assert totals.answers["accepted"] == 1
    assert totals.answers["rejected"] == len(reasons)
    assert totals.refusals == totals.as_json()["refusals"] == refusals
