"""The nearby query as one writes it by hand: FastAPI, asyncpg, PostGIS and orjson, without keys, caches or checks.

Run by `benchmarks.server` with the Python of the peers: `python -m benchmarks.peer_by_hand DATABASE_URL`.
"""

from __future__ import annotations

import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import asyncpg
import orjson  # type: ignore[import-not-found]  # it is in the environment of the peers
from fastapi import FastAPI, Response

from benchmarks.server_listen import serve

_NEARBY = """
    SELECT id, latitude_deg, longitude_deg, kind, sign, state, version, revision,
           box_length_mm, box_width_mm, box_yaw_rad, box_relief_mm,
           box_sd_ln_length, box_sd_ln_width, box_sd_ln_area, box_sd_relief_mm,
           volume_m3, east_m2, north_m2, east_north_m2, altitude_m, confidence, as_of, half_life_s, expires_at,
           first_seen, last_seen, sightings, witnesses, succeeds, merged_into, removed_reason, inspection_state
    FROM obstacle
    WHERE ST_DWithin(place, ST_MakePoint($1, $2)::geography, $3) AND state <> 'removed' AND expires_at > now()
    ORDER BY ST_Distance(place, ST_MakePoint($1, $2)::geography), id LIMIT 1000
"""


def by_hand(database_url: str) -> FastAPI:
    """`GET /v1/obstacles?lat=&lon=&radius_m=` with the service's own features, nearest first."""

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        # As many connections as the peers and asyncpg itself take by default.
        async with asyncpg.create_pool(database_url, min_size=10, max_size=10) as app.state.pool:
            yield

    app = FastAPI(lifespan=lifespan)

    @app.get("/v1/obstacles")
    async def get_obstacles(lat: float, lon: float, radius_m: float) -> Response:
        rows = await app.state.pool.fetch(_NEARBY, lon, lat, radius_m)
        found = {"type": "FeatureCollection", "features": [_feature(row) for row in rows]}
        return Response(orjson.dumps(found, default=str, option=orjson.OPT_UTC_Z), media_type="application/geo+json")

    return app


def _feature(row: asyncpg.Record) -> dict[str, Any]:
    return {
        "type": "Feature",
        "id": row["id"],
        "geometry": {"type": "Point", "coordinates": (row["longitude_deg"], row["latitude_deg"])},
        "properties": {
            "kind": row["kind"],
            "sign": row["sign"],
            "state": row["state"],
            "version": row["version"],
            "revision": row["revision"],
            "box": {
                "length_mm": row["box_length_mm"],
                "width_mm": row["box_width_mm"],
                "yaw_rad": row["box_yaw_rad"],
                "relief_mm": row["box_relief_mm"],
            },
            "box_sd": {
                "ln_length": row["box_sd_ln_length"],
                "ln_width": row["box_sd_ln_width"],
                "ln_area": row["box_sd_ln_area"],
                "relief_mm": row["box_sd_relief_mm"],
            },
            "volume_m3": row["volume_m3"],
            "position_covariance": {
                "east_m2": row["east_m2"],
                "north_m2": row["north_m2"],
                "east_north_m2": row["east_north_m2"],
            },
            "altitude_m": row["altitude_m"],
            "confidence": row["confidence"],
            "as_of": row["as_of"],
            "half_life_s": row["half_life_s"],
            "expires_at": row["expires_at"],
            "first_seen": row["first_seen"],
            "last_seen": row["last_seen"],
            "sightings": row["sightings"],
            "witnesses": row["witnesses"],
            "succeeds": row["succeeds"],
            "merged_into": row["merged_into"],
            "removed_reason": row["removed_reason"],
            "inspection_state": row["inspection_state"],
        },
    }


if __name__ == "__main__":
    serve(by_hand(sys.argv[1]))
