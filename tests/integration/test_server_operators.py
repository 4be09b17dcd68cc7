"""Operators' actions, the audit log, and an obstacle's history and points, on both databases."""

from __future__ import annotations

import asyncio
import json
from typing import Any
from uuid import UUID, uuid4

import httpx
import pymap3d
import pytest
from sqlalchemy import text

from contract.history import ActionLog, ObstacleHistory
from contract.obstacle import ObstacleFeature, ObstaclePoints
from server.settings import Settings
from server.storage.database import Database
from server.trust.keys import Keys, Role
from tests.integration.asking import AROUND_PATRAS, ago, created, obstacles, pages, posted
from tests.integration.conftest import OPERATOR_KEY, serving
from tests.unit.server.making import absent, detection, message

POINTS = ((0, 0, 0), (-150, 20, -9), (30, -40, 5))
CONFIRM: dict[str, Any] = {"action": "confirm"}
REPAIRED: dict[str, Any] = {"action": "repaired", "note": "filled with asphalt"}


async def one(client: httpx.AsyncClient) -> UUID:
    seen = detection().model_copy(update={"points_cm": POINTS})
    (identifier,) = await created(client, message(seen, vehicle="ego1", at=ago(9)))
    return identifier


async def act(client: httpx.AsyncClient, identifier: UUID, action: Any, **headers: str) -> httpx.Response:
    path = f"/v1/obstacles/{identifier}/actions"
    return await client.post(
        path, json=action, headers={name.replace("_", "-"): value for name, value in headers.items()}
    )


async def log(client: httpx.AsyncClient, **query: Any) -> ActionLog:
    answer = await client.get("/v1/actions", params=query)
    assert answer.status_code == 200, answer.text
    return ActionLog.model_validate_json(answer.content)


async def history(client: httpx.AsyncClient, identifier: UUID) -> ObstacleHistory:
    answer = await client.get(f"/v1/obstacles/{identifier}/history")
    assert answer.status_code == 200, answer.text
    return ObstacleHistory.model_validate_json(answer.content)


async def test_an_operator_confirms_schedules_and_repairs(client: httpx.AsyncClient) -> None:
    identifier = await one(client)
    steps = [
        (CONFIRM, ("confirmed", "inspected", 2)),
        ({"action": "inspection_state", "inspection_state": "scheduled"}, ("confirmed", "scheduled", 3)),
        (REPAIRED, ("removed", "repaired", 4)),
    ]
    for action, expected in steps:
        for _ in ("first", "again"):
            answer = await act(client, identifier, action, X_Request_Id="req-7")
            served = ObstacleFeature.model_validate_json(answer.content).properties
            assert (served.state, served.inspection_state, served.revision) == expected
    assert await obstacles(client, **AROUND_PATRAS) == ()
    (removed,) = await obstacles(client, **AROUND_PATRAS, state="removed")
    assert (removed.id, removed.properties.removed_reason) == (identifier, "operator")
    actions = (await log(client)).actions
    assert [item.action for item in actions] == ["confirm", "inspection_state", "repaired"]
    assert [(item.before.revision, item.after.revision) for item in actions if item.before and item.after] == [
        (1, 2),
        (2, 3),
        (3, 4),
    ]
    assert {(item.key_id, item.request_id) for item in actions} == {("open", "req-7")}
    assert actions[-1].note == "filled with asphalt"


async def test_what_was_repaired_and_is_seen_again_is_a_new_obstacle(client: httpx.AsyncClient) -> None:
    identifier = await one(client)
    await act(client, identifier, REPAIRED)
    answer = await act(client, identifier, CONFIRM)
    assert (answer.status_code, answer.json()["type"]) == (409, "urn:headsup:problem:obstacle-removed")
    (late,) = await posted(client, message(detection(), vehicle="ego2", at=ago(1)))
    assert (late.detections[0].decision, late.detections[0].obstacle_id) == ("superseded", identifier)
    (again,) = await posted(client, message(detection(), vehicle="ego3", at=ago(0)))
    assert again.detections[0].decision == "created"
    (feature,) = await obstacles(client, **AROUND_PATRAS)
    assert feature.properties.succeeds == identifier


async def test_an_action_on_what_has_changed_is_refused(client: httpx.AsyncClient) -> None:
    identifier = await one(client)
    read = await client.get(f"/v1/obstacles/{identifier}")
    as_denm = await client.get(f"/v1/obstacles/{identifier}?f=denm")
    await posted(client, message(detection(), vehicle="ego2", at=ago(8)))
    for stale in (read.headers["etag"], as_denm.headers["etag"], 'W/"2-geojson"', '"2"', "nonsense"):
        answer = await act(client, identifier, REPAIRED, If_Match=stale)
        assert (answer.status_code, answer.json()["type"]) == (412, "urn:headsup:problem:revision-mismatch")
    refused = await client.delete(f"/v1/obstacles/{identifier}", headers={"If-Match": read.headers["etag"]})
    assert refused.status_code == 412
    current = (await client.get(f"/v1/obstacles/{identifier}")).headers["etag"]
    answer = await act(client, identifier, REPAIRED, If_Match=f'"7-geojson", {current}')
    assert answer.status_code == 200
    assert answer.headers["etag"] != current
    assert (await act(client, identifier, REPAIRED, If_Match="*")).status_code == 200


async def test_deleting_erases_points_and_descriptors_of_all_versions(
    client: httpx.AsyncClient, database_url: str
) -> None:
    identifier = await one(client)
    larger = detection(length_mm=1500).model_copy(update={"points_cm": POINTS})
    await posted(client, message(larger, vehicle="ego2", at=ago(8)))
    assert [(await client.delete(f"/v1/obstacles/{identifier}")).status_code for _ in range(2)] == [204, 204]
    for version in (1, 2):
        answer = await client.get(f"/v1/obstacles/{identifier}/points?version={version}")
        assert ObstaclePoints.model_validate_json(answer.content).geometry.coordinates == ()
    database = Database.open(database_url)
    async with database.read() as connection:
        for table in ("obstacle", "obstacle_version"):
            for row in await connection.execute(text(f"SELECT shape FROM {table}")):  # noqa: S608  # two fixed names
                shape = row.shape if isinstance(row.shape, dict) else json.loads(row.shape)
                assert (shape["points_cm"], shape["descriptor"]["values"]) == ([], {})
    await database.close()
    entries = (await history(client, identifier)).entries
    assert [entry.action for entry in entries if entry.type == "action"] == ["delete"]
    assert await obstacles(client, **AROUND_PATRAS) == ()


async def test_a_history_tells_everything_in_order_and_in_pages(client: httpx.AsyncClient) -> None:
    identifier = await one(client)
    await posted(client, message(detection(), vehicle="ego2", at=ago(8)))
    await posted(client, message(detection(length_mm=1500), vehicle="ego3", at=ago(7)))
    await act(client, identifier, CONFIRM)
    missed = [message(vehicle=f"ego{n}", at=ago(7 - n), inspections=(absent(identifier),)) for n in (4, 5)]
    await posted(client, *missed)
    await act(client, identifier, {"action": "inspection_state", "inspection_state": "repaired"})
    entries = (await history(client, identifier)).entries
    events = [entry for entry in entries if entry.type == "event"]
    assert [(entry.what, entry.obstacle.properties.revision) for entry in events] == [
        ("created", 1),
        ("updated", 2),
        ("updated", 3),
        ("updated", 4),
        ("updated", 5),
        ("removed", 6),
        ("updated", 7),
    ]
    assert events[5].reason == "absent"
    versions = [entry for entry in entries if entry.type == "version"]
    assert [(entry.version, entry.box.length_mm) for entry in versions] == [(1, 1000), (2, 1500)]
    assert [entry.until is None for entry in versions] == [False, True]
    assert versions[0].points == len(POINTS)
    assert [entry.action for entry in entries if entry.type == "action"] == ["confirm", "inspection_state"]
    assert [entry.at for entry in entries] == sorted(entry.at for entry in entries)
    for limit in (1, 2, 5):
        found = await pages(client, f"/v1/obstacles/{identifier}/history", limit=limit)
        together = [entry for page in found for entry in ObstacleHistory.model_validate(page).entries]
        assert together == list(entries)


async def test_points_lie_where_they_were_measured(client: httpx.AsyncClient) -> None:
    identifier = await one(client)
    feature = ObstacleFeature.model_validate_json((await client.get(f"/v1/obstacles/{identifier}")).content)
    answer = await client.get(f"/v1/obstacles/{identifier}/points")
    assert answer.headers["content-type"] == "application/geo+json"
    found = ObstaclePoints.model_validate_json(answer.content)
    assert (found.properties.version, found.properties.kind) == (1, "pothole")
    centre = feature.position
    for (longitude_deg, latitude_deg, height_m), offset_cm in zip(found.geometry.coordinates, POINTS, strict=True):
        east_north_up_m = pymap3d.geodetic2enu(
            latitude_deg,
            longitude_deg,
            height_m,
            centre.latitude_deg,
            centre.longitude_deg,
            feature.properties.altitude_m,
        )
        assert east_north_up_m == pytest.approx([number / 100 for number in offset_cm], abs=2e-3)
    missing = await client.get(f"/v1/obstacles/{identifier}/points?version=9")
    assert (missing.status_code, missing.json()["type"]) == (404, "urn:headsup:problem:version-not-found")


async def test_the_audit_log_has_pages_and_is_asked_by_obstacle(client: httpx.AsyncClient) -> None:
    ids = await created(client, message(*(detection(20 * n, 0) for n in range(4)), at=ago(2)))
    for identifier in ids:
        await act(client, identifier, CONFIRM, traceparent=f"00-{'ab' * 16}-{'cd' * 8}-01")
    found = await pages(client, "/v1/actions", limit=3)
    assert [len(page["actions"]) for page in found] == [3, 1]
    assert [UUID(item["obstacle_id"]) for page in found for item in page["actions"]] == ids
    (only,) = (await log(client, obstacle_id=ids[2])).actions
    assert (only.obstacle_id, only.request_id) == (ids[2], "ab" * 16)


async def test_unknown_obstacles_and_faulty_actions_are_problems(client: httpx.AsyncClient) -> None:
    nobody = uuid4()
    assert (await act(client, nobody, CONFIRM)).status_code == 404
    assert (await client.delete(f"/v1/obstacles/{nobody}")).status_code == 404
    for path in ("history", "points"):
        assert (await client.get(f"/v1/obstacles/{nobody}/{path}")).status_code == 404
    identifier = await one(client)
    for faulty in ({}, {"action": "explode"}, {"action": "inspection_state"}, CONFIRM | {"force": True}, []):
        assert (await act(client, identifier, faulty)).status_code == 422
    plain = await client.post(
        f"/v1/obstacles/{identifier}/actions", content=b"{}", headers={"Content-Type": "text/plain"}
    )
    assert plain.status_code == 415
    assert (await client.get(f"/v1/obstacles/{identifier}/history?cursor=x")).status_code == 422
    assert (await client.get(f"/v1/obstacles/{identifier}?foo=1")).status_code == 422


async def test_actions_and_sightings_at_once_lose_nothing(client: httpx.AsyncClient) -> None:
    identifier = await one(client)
    sightings = [posted(client, message(detection(), vehicle=f"car{n}", at=ago(1), number=n)) for n in range(8)]
    states = ["inspected", "scheduled", "open", "not_an_issue"]
    actions = [act(client, identifier, {"action": "inspection_state", "inspection_state": state}) for state in states]
    await asyncio.gather(*sightings, *actions)
    feature = ObstacleFeature.model_validate_json((await client.get(f"/v1/obstacles/{identifier}")).content)
    entries = (await history(client, identifier)).entries
    revisions = [entry.obstacle.properties.revision for entry in entries if entry.type == "event"]
    assert feature.properties.sightings == 9
    assert sorted(revisions) == list(range(1, feature.properties.revision + 1))


async def test_only_operators_act(guarded: Settings) -> None:
    database = Database.open(guarded.database_url)
    keys = Keys(database, None)
    bearers = {
        role: {"Authorization": f"Bearer {await keys.create(role, role.value)}"} for role in (Role.VEHICLE, Role.READER)
    }
    await database.close()
    operator = {"Authorization": f"Bearer {OPERATOR_KEY}"}
    async with serving(guarded) as client:
        client.headers.update(bearers[Role.VEHICLE])
        identifier = await one(client)
        for bearer in bearers.values():
            refused = [
                await client.post(f"/v1/obstacles/{identifier}/actions", json=CONFIRM, headers=bearer),
                await client.delete(f"/v1/obstacles/{identifier}", headers=bearer),
                await client.get("/v1/actions", headers=bearer),
            ]
            assert [answer.status_code for answer in refused] == [403] * 3
            assert (await client.get(f"/v1/obstacles/{identifier}/history", headers=bearer)).status_code == 200
        done = await client.post(f"/v1/obstacles/{identifier}/actions", json=CONFIRM, headers=operator)
        (line,) = (await client.get("/v1/actions", headers=operator)).json()["actions"]
        told = (await client.get(f"/v1/obstacles/{identifier}/history")).text
    assert done.status_code == 200
    assert line["key_id"] == "bootstrap"
    assert "bootstrap" not in told
