"""What lies equally far, to some micrometres, is in one order whichever way a circle is answered."""

from __future__ import annotations

import math
import random

import httpx

from server.geometry.geodesy import offset_from
from server.reading.around import geodesic
from tests.integration.asking import AROUND_PATRAS, ago, created, obstacles
from tests.unit.server.making import PATRAS, detection, message

RING_M = 1_900.0


async def test_near_ties_have_one_order_in_both_ways_of_answering(client: httpx.AsyncClient) -> None:
    """At 1,900 m the metric of the quick way is off by up to 3 mm."""
    rng = random.Random(1)  # noqa: S311  # a test's places
    azimuths_rad = [math.radians(15 * step + 3) for step in range(24)]
    around = [
        offset_from(PATRAS, radius_m * math.sin(azimuth_rad), radius_m * math.cos(azimuth_rad))
        for azimuth_rad in azimuths_rad
        for radius_m in [RING_M + rng.uniform(-1e-3, 1e-3)]
    ]
    seen = [message(detection(0, 0), at=ago(1), position=place, vehicle=f"v{n}") for n, place in enumerate(around)]
    await created(client, *seen)
    found = await obstacles(client, **AROUND_PATRAS)
    distances_m = [geodesic(PATRAS, item.position.latitude_deg, item.position.longitude_deg)[0] for item in found]
    assert len(found) == len(around)
    assert distances_m == sorted(distances_m)
    assert distances_m[-1] - distances_m[0] < 0.01
    quick = await client.get("/v1/obstacles", params=AROUND_PATRAS)
    typed = await client.get("/v1/obstacles", params=AROUND_PATRAS | {"f": "geojson"})
    assert quick.content == typed.content
    assert quick.headers["etag"] == typed.headers["etag"]
