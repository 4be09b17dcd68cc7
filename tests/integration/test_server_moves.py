"""An obstacle that wanders over the border of two tiles while everybody asks for it is told exactly once."""

from __future__ import annotations

import asyncio
from collections import Counter
from datetime import UTC, datetime, timedelta

import httpx

from contract.geometry import LatLon
from server.settings import Settings
from tests.integration.asking import posted
from tests.integration.conftest import serving
from tests.unit.server.making import detection, message

CORNER = LatLon(latitude_deg=0.0, longitude_deg=0.0)
_NORTHS_M = [30.0 * number for number in range(-2, 3)]


async def _wanders(client: httpx.AsyncClient, moves: int) -> set[str]:
    """See some holes on both sides of a border in turn, so that their mean places cross it; ids of the holes."""
    mean_m, known = 0.3, set()
    for number in range(moves):
        # The mean of n + 1 sightings comes to lie as far on the other side.
        east_m = mean_m if number == 0 else -mean_m * (2 * number + 1)
        mean_m = mean_m if number == 0 else -mean_m
        seen = [detection(east_m, north_m, centre_sd_m=0.01) for north_m in _NORTHS_M]
        at = datetime.now(UTC) - timedelta(seconds=60)
        (result,) = await posted(client, message(*seen, vehicle=f"v{number}", number=number, at=at, position=CORNER))
        known |= {str(item.obstacle_id) for item in result.detections}
    return known


async def _asks(
    client: httpx.AsyncClient, done: asyncio.Event, holes: set[str], told: Counter[tuple[int, ...]]
) -> None:
    """Count answers by how often each of the holes is in them."""
    while not done.is_set():
        answer = await client.get("/v1/obstacles?lat=0&lon=0&radius_m=200")
        times = Counter(item["id"] for item in answer.json()["features"])
        told[tuple(sorted({times[hole] for hole in holes}))] += 1


async def test_an_obstacle_on_its_way_to_another_tile_is_told_once(settings: Settings) -> None:
    told: Counter[tuple[int, ...]] = Counter()
    async with serving(settings) as writing, serving(settings) as reading:
        holes = await _wanders(writing, 1)
        done = asyncio.Event()
        asking = [asyncio.create_task(_asks(reading, done, holes, told)) for _ in range(6)]
        try:
            await _wanders(writing, 10)
        finally:
            done.set()
            await asyncio.gather(*asking)
    assert len(holes) == len(_NORTHS_M)
    assert set(told) == {(1,)}, told
