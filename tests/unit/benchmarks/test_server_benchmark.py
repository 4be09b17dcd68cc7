"""What the service is measured on is what it claims to be: as dense as stated, valid, the same for the same seed."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from uuid import UUID

import numpy as np
import pytest

from benchmarks.server_data import NEIGHBOURS, City, obstacle_at, repeated, synthetic_city
from benchmarks.server_load import Cost, Load, script
from benchmarks.server_report import Row
from benchmarks.server_reports import FORMS, Form, write_bodies
from contract.observation import MAX_BODY_BYTES, ObservationBatch
from server.ingesting.parcel import Parcel, opened
from server.life.decay import expires_at
from server.life.policy import COOPERATION
from server.rules import Report
from server.storage import rows

NOW = datetime(2026, 6, 1, 12, tzinfo=UTC)


def test_a_circle_holds_about_twenty_however_many_obstacles_there_are() -> None:
    city = synthetic_city(seed=1, number=4_000)
    assert city.stretched().neighbours() == pytest.approx(NEIGHBOURS, rel=0.02)
    few, many = repeated([city], 1_000, seed=1), repeated([city], 11_000, seed=1)
    assert (len(few), len(many)) == (1_000, 11_000)
    assert City(few).neighbours() == pytest.approx(NEIGHBOURS, rel=0.1)
    assert City(many).neighbours() == pytest.approx(NEIGHBOURS, rel=0.1)


def test_the_same_seed_gives_the_same_places() -> None:
    first, again, other = (repeated([synthetic_city(seed)], 30_000, seed) for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_obstacles_are_served_and_come_back_from_their_rows() -> None:
    obstacle = obstacle_at([40.7, -74.0], 7, NOW, np.random.default_rng(1))
    row = rows.row_of(obstacle, COOPERATION.life)
    assert rows.obstacle_of(row, obstacle.evidence) == obstacle  # type: ignore[arg-type]  # a mapping is enough
    assert obstacle.is_live
    assert expires_at(obstacle, COOPERATION.life) > NOW


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
def test_reports_are_believed_and_no_two_are_one(form: Form, tmp_path: Path) -> None:
    write_bodies(tmp_path / "bodies", form, 5, synthetic_city(1).places_deg, seed=3, now=NOW)
    lines = (tmp_path / "bodies").read_text().splitlines()
    assert max(map(len, lines)) < MAX_BODY_BYTES
    batches = [ObservationBatch.model_validate_json(line) for line in lines]
    reports = [report for batch in batches for report in batch.reports]
    assert len({report.report_id for report in reports}) == 5 * form.reports
    for report in reports:
        parcel = Parcel(report, NOW, NOW, "open", report.pseudonym, report.model_dump_json())
        assert isinstance(opened(parcel, COOPERATION, ()), Report)
        assert isinstance(report.report_id, UUID)


def test_a_load_goes_on_where_it_stopped_and_keeps_its_pace() -> None:
    load = Load(Path("lines"), connections=32)
    assert load.beginning(1_000).first == 500, "each of two threads took half of them"
    assert load.at(per_second=640).pause_ms == pytest.approx(50)
    assert "function delay" in script(paced=True)
    assert "if false then" in script(paced=False)


def test_a_row_is_the_median_of_its_rounds() -> None:
    costs = [Cost(100, 2.0, app_us, 10.0, 1.0, 2.0, 300.0) for app_us in (90.0, 500.0, 110.0)]
    row = Row("service", costs)
    assert (row.cpu_us, row.per_second) == (120.0, 50.0)
