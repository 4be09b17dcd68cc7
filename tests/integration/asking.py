"""How the integration tests report obstacles and read them."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any
from uuid import UUID

import httpx

from contract.geometry import LatLon
from contract.observation import ObservationBatch, ObservationBatchResult, ObservationReport, ReportResult
from contract.obstacle import ObstacleCollection, ObstacleFeature
from server.reading.around import Circle
from server.reading.query import ObstacleQuery
from server.reading.search import Search
from server.web.dependencies import Parts
from tests.unit.server.making import HOUR, PATRAS

JSON = {"Content-Type": "application/json"}
AROUND_PATRAS = {"lat": PATRAS.latitude_deg, "lon": PATRAS.longitude_deg, "radius_m": 2_000}


def ago(hours: float) -> datetime:
    return datetime.now(UTC) - hours * HOUR


async def posted(client: httpx.AsyncClient, *reports: ObservationReport) -> list[ReportResult]:
    batch = ObservationBatch(sent_at=datetime.now(UTC), reports=reports)
    answer = await client.post("/v1/observations", content=batch.model_dump_json(), headers=JSON)
    assert answer.status_code == 200, answer.text
    return list(ObservationBatchResult.model_validate_json(answer.content).results)


async def created(client: httpx.AsyncClient, *reports: ObservationReport) -> list[UUID]:
    """Ids of what the reports created, in order."""
    found = [item for result in await posted(client, *reports) for item in result.detections]
    assert [item.decision for item in found] == ["created"] * len(found)
    return [item.obstacle_id for item in found if item.obstacle_id is not None]


async def obstacles(client: httpx.AsyncClient, **query: Any) -> tuple[ObstacleFeature, ...]:
    answer = await client.get("/v1/obstacles", params=query)
    assert answer.status_code == 200, answer.text
    return ObstacleCollection.model_validate_json(answer.content).features


async def by_sql(client: httpx.AsyncClient, **query: Any) -> list[dict[str, Any]]:
    """All that SQL finds, where the client's server, in this process, may answer from memory."""
    transport = client._transport
    assert isinstance(transport, httpx.ASGITransport)
    parts: Parts = transport.app.state.parts  # type: ignore[attr-defined]  # FastAPI's
    asked = ObstacleQuery.model_validate(query)
    async with parts.database.read() as connection:
        search = Search(connection, parts.life, datetime.now(UTC))
        if isinstance(asked.area, Circle):
            page = await search.around(asked.area, asked.filters, None, 100_000)
        else:
            page = await search.inside(asked.area, asked.filters, None, 100_000)
    return [feature.model_dump(mode="json") for feature in page.features]


async def pages(client: httpx.AsyncClient, path: str, **query: Any) -> list[dict[str, Any]]:
    """Every page, by the links `next`."""
    answer = await client.get(path, params=query)
    found = []
    while True:
        assert answer.status_code == 200, answer.text
        page = answer.json()
        found.append(page)
        assert len(found) < 200, "the pages do not end"
        following = [link["href"] for link in page.get("links", []) if link["rel"] == "next"]
        if not following:
            return found
        answer = await client.get(following[0])


def near(latitude_deg: float, longitude_deg: float) -> LatLon:
    return LatLon(latitude_deg=latitude_deg, longitude_deg=longitude_deg)
