"""Vehicles, operators and restarts in any order, against a model of what must hold whatever the rule decides."""

from __future__ import annotations

import asyncio
import tempfile
from collections.abc import Callable, Coroutine
from contextlib import AbstractAsyncContextManager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, TypeVar
from uuid import UUID

import httpx
import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from contract.observation import ObservationBatch, ObservationBatchResult, ObservationReport, ReportResult, ReportStatus
from contract.obstacle import ObstacleFeature
from server.settings import Settings
from tests.integration.asking import AROUND_PATRAS, JSON, obstacles
from tests.integration.conftest import fresh_postgres, serving, upgraded
from tests.integration.invariants import assert_consistent, read_all
from tests.unit.server.making import absent, detection, message

T = TypeVar("T")
_COUNTED = {"created", "kept", "updated"}
_SKEWS_S = [0.0, 1.5, -1.9, -90.0, 540.0, -540.0]
_DEEDS = [
    '{"action":"confirm"}',
    '{"action":"dismiss"}',
    '{"action":"repaired"}',
    '{"action":"inspection_state","inspection_state":"scheduled"}',
]
# Two close together, which may be taken for one, and some that are not.
_HOLES = [(0.0, 0.0), (2.5, 0.0), (40.0, 0.0), (0.0, 60.0)]


class Lives(RuleBasedStateMachine):
    """One server on a fresh database."""

    def __init__(self, make_url: Callable[[Path], str]) -> None:
        super().__init__()
        self._folder = tempfile.TemporaryDirectory()
        self._url = make_url(Path(self._folder.name))
        self._runner = asyncio.Runner()
        self._run(upgraded(self._url))
        self._server: AbstractAsyncContextManager[httpx.AsyncClient] | None = None
        self._sent: list[tuple[ObservationReport, ReportResult]] = []
        self._seen: dict[UUID, ObstacleFeature] = {}
        self._tags: dict[tuple[UUID, int], str] = {}
        self._vehicles = self._counted = 0

    @initialize()
    def starts(self) -> None:
        """The server starts."""
        self._server = serving(Settings(database_url=self._url))
        self._client = self._run(self._server.__aenter__())

    @rule(
        hole=st.sampled_from(_HOLES),
        offset_m=st.sampled_from([-0.4, 0.0, 0.3]),
        length_mm=st.sampled_from([900, 1000, 1400]),
        hours_ago=st.sampled_from([0.01, 0.5, 5.0, 100.0]),
        skew_s=st.sampled_from(_SKEWS_S),
    )
    def sees(self, hole: tuple[float, float], offset_m: float, length_mm: int, hours_ago: float, skew_s: float) -> None:
        """Another vehicle sees a hole, perhaps long ago, with its own idea of the time."""
        seen = detection(hole[0] + offset_m, hole[1], length_mm)
        result = self._reports(hours_ago, skew_s, seen)
        self._counted += sum(item.decision in _COUNTED for item in result.detections)
        assert [item.decision for item in result.detections] != ["rejected"]

    @precondition(lambda self: self._seen)
    @rule(data=st.data(), hours_ago=st.sampled_from([0.01, 1.0, 50.0]))
    def misses(self, data: st.DataObject, hours_ago: float) -> None:
        """Another vehicle does not find an obstacle."""
        identifier = data.draw(st.sampled_from(sorted(self._seen)))
        result = self._reports(hours_ago, 0.0, inspected=identifier)
        if result.inspections[0].removed:
            assert self._seen[identifier].properties.state != "removed"

    @precondition(lambda self: self._sent)
    @rule(data=st.data())
    def repeats(self, data: st.DataObject) -> None:
        """A vehicle that lost the answer sends a report again."""
        report, first = data.draw(st.sampled_from(self._sent))
        assert self._posted(report, 0.0) == first.model_copy(update={"status": ReportStatus.DUPLICATE})

    @rule(skew_s=st.sampled_from([-700.0, 700.0]))
    def a_clock_is_too_wrong(self, skew_s: float) -> None:
        """A report whose time is a riddle changes nothing."""
        self._vehicles += 1
        at = datetime.now(UTC) + timedelta(seconds=skew_s)
        result = self._posted(message(detection(), vehicle=f"v{self._vehicles}", at=at), skew_s)
        assert (result.status, result.reason) == ("rejected", "clock-skew")

    @precondition(lambda self: self._seen)
    @rule(data=st.data(), deed=st.sampled_from(_DEEDS))
    def acts(self, data: st.DataObject, deed: str) -> None:
        """An operator acts on an obstacle, twice: the second time changes nothing."""
        identifier = data.draw(st.sampled_from(sorted(self._seen)))
        path = f"/v1/obstacles/{identifier}/actions"
        first, second = (self._run(self._client.post(path, content=deed, headers=JSON)) for _ in range(2))
        assert (
            first.status_code == second.status_code == (409 if "confirm" in deed and self._is_gone(identifier) else 200)
        )
        assert first.content == second.content or first.status_code == 409

    @precondition(lambda self: self._seen)
    @rule(data=st.data())
    def erases(self, data: st.DataObject) -> None:
        """An operator deletes an obstacle."""
        identifier = data.draw(st.sampled_from(sorted(self._seen)))
        assert self._run(self._client.delete(f"/v1/obstacles/{identifier}")).status_code == 204

    @rule()
    def restarts(self) -> None:
        """The server ends and starts again: what it kept in memory is gone."""
        self._stopped()
        self.starts()

    @invariant()
    def only_what_was_answered_has_happened(self) -> None:
        """Revisions only rise, tags change with them, what is gone stays gone, and searches know the rest."""
        if self._server is None:
            return
        for identifier, before in list(self._seen.items()):
            self._seen[identifier] = self._followed(before)
        live = {identifier for identifier, feature in self._seen.items() if feature.properties.state != "removed"}
        for query in ({}, {"f": "geojson"}):
            found = self._run(obstacles(self._client, **AROUND_PATRAS, **query))
            assert {feature.id: feature for feature in found} == {item: self._seen[item] for item in live}
        self._no_answered_sighting_is_lost()

    def _no_answered_sighting_is_lost(self) -> None:
        """What merged brought its sightings along."""
        told = [feature.properties for feature in self._seen.values()]
        assert sum(properties.sightings for properties in told if properties.merged_into is None) == self._counted

    def teardown(self) -> None:
        """The database is whole, and holds what was answered."""
        self._stopped()
        found = self._run(read_all(self._url))
        self._runner.close()
        self._folder.cleanup()
        assert_consistent(found)
        assert found.answers == {str(report.report_id): result for report, result in self._sent}
        assert {row["id"] for row in found.obstacles} == set(self._seen)

    def _followed(self, before: ObstacleFeature) -> ObstacleFeature:
        answer = self._run(self._client.get(f"/v1/obstacles/{before.id}"))
        now = ObstacleFeature.model_validate_json(answer.content)
        was, properties = before.properties, now.properties
        assert properties.revision >= was.revision
        assert properties.version >= was.version
        assert (properties.revision == was.revision) == (now == before)
        assert was.state != "removed" or properties.state == "removed"
        tag = self._tags.setdefault((before.id, properties.revision), answer.headers["etag"])
        assert answer.headers["etag"] == tag
        assert len(set(self._tags.values())) >= len({revision for _, revision in self._tags})
        return now

    def _is_gone(self, identifier: UUID) -> bool:
        return self._seen[identifier].properties.state == "removed"

    def _reports(self, hours_ago: float, skew_s: float, *seen: Any, inspected: UUID | None = None) -> ReportResult:
        self._vehicles += 1
        at = datetime.now(UTC) - timedelta(hours=hours_ago) + timedelta(seconds=skew_s)
        looked = () if inspected is None else (absent(inspected),)
        report = message(*seen, inspections=looked, vehicle=f"v{self._vehicles}", at=at)
        result = self._posted(report, skew_s)
        assert result.status is ReportStatus.ACCEPTED, result.reason
        self._sent.append((report, result))
        for item in result.detections:
            if item.decision == "created":
                assert item.obstacle_id is not None
                assert item.obstacle_id not in self._seen, "an id came back"
                self._seen[item.obstacle_id] = self._run(self._one(item.obstacle_id))
        return result

    async def _one(self, identifier: UUID) -> ObstacleFeature:
        return ObstacleFeature.model_validate_json((await self._client.get(f"/v1/obstacles/{identifier}")).content)

    def _posted(self, report: ObservationReport, skew_s: float) -> ReportResult:
        batch = ObservationBatch(sent_at=datetime.now(UTC) + timedelta(seconds=skew_s), reports=(report,))
        answer = self._run(self._client.post("/v1/observations", content=batch.model_dump_json(), headers=JSON))
        assert answer.status_code == 200, answer.text
        (result,) = ObservationBatchResult.model_validate_json(answer.content).results
        return result

    def _stopped(self) -> None:
        if self._server is not None:
            self._run(self._server.__aexit__(None, None, None))
            self._server = None

    def _run(self, work: Coroutine[Any, Any, T]) -> T:
        return self._runner.run(work)


def _lived(make_url: Callable[[Path], str], examples: int, steps: int) -> None:
    profile = settings(
        max_examples=examples,
        stateful_step_count=steps,
        deadline=None,
        database=None,
        derandomize=True,
        # Shrinking lives takes an hour; the steps that failed are printed as they are.
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    run_state_machine_as_test(lambda: Lives(make_url), settings=profile)


@pytest.fixture(params=["sqlite", "postgresql"])
def make_url(request: pytest.FixtureRequest) -> Callable[[Path], str]:
    """Makes a fresh database."""
    if request.param == "sqlite":
        return lambda folder: f"sqlite+aiosqlite:///{folder}/headsup.sqlite3"
    postgres = request.getfixturevalue("postgres")
    return lambda _: fresh_postgres(postgres)


def test_whatever_vehicles_and_operators_do_what_was_answered_holds(make_url: Callable[[Path], str]) -> None:
    _lived(make_url, examples=3, steps=15)


@pytest.mark.soak
def test_whatever_they_do_for_long(make_url: Callable[[Path], str]) -> None:
    _lived(make_url, examples=8, steps=40)
