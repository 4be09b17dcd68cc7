"""The peers as processes: PostGIS by hand, tipg and pygeoapi, each one process with a pool of connections.

They live in a virtual environment of their own (`benchmarks.server` says how it is made), so that none of what they
need is ours.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlencode

from benchmarks.peer_data import FEATURES
from benchmarks.peer_postgis import AbsentError, PostGis
from benchmarks.server_processes import Measured, listening
from benchmarks.server_queries import PathOf, box_text, circle_path

_LIMIT = 1_000
# With pygeoapi's default, CRS84, four fifths of a request go into looking for a number that it does not have. Told that
# the request, the table and the answer have the same system, it takes all coordinates as they are.
_EPSG_4326 = "http://www.opengis.net/def/crs/EPSG/0/4326"
_LISTEN = "benchmarks.server_listen"


@dataclass(frozen=True, slots=True)
class Peer:
    """A server beside which ours is measured."""

    name: str
    package: str
    path_of: PathOf
    start: Callable[[Path, PostGis, str, Path], AbstractContextManager[Measured]]
    """Runs it with a Python of its own, on a database, with a folder for its files."""


def _tipg_path(latitude_deg: float, longitude_deg: float, radius_m: float) -> str:
    return f"/collections/public.{FEATURES}/items?{_box_query(latitude_deg, longitude_deg, radius_m, 'geojson')}"


def _pygeoapi_path(latitude_deg: float, longitude_deg: float, radius_m: float) -> str:
    system = urlencode({"bbox-crs": _EPSG_4326, "crs": _EPSG_4326})
    return f"/collections/{FEATURES}/items?{_box_query(latitude_deg, longitude_deg, radius_m, 'json')}&{system}"


def _box_query(latitude_deg: float, longitude_deg: float, radius_m: float, form: str) -> str:
    return urlencode({"bbox": box_text(latitude_deg, longitude_deg, radius_m), "limit": _LIMIT, "f": form}, safe=",")


def _by_hand(python: Path, server: PostGis, database: str, folder: Path) -> AbstractContextManager[Measured]:
    return listening((str(python), "-m", "benchmarks.peer_by_hand", server.url(database)), {}, server.pid)


def _tipg(python: Path, server: PostGis, database: str, folder: Path) -> AbstractContextManager[Measured]:
    environment = {
        "DATABASE_URL": server.url(database),
        "TIPG_DB_TABLES": json.dumps([f"public.{FEATURES}"]),
        # Else it reads the whole table every five minutes.
        "TIPG_DB_SPATIAL_EXTENT": "false",
        "TIPG_DB_DATETIME_EXTENT": "false",
        "TIPG_CATALOG_TTL": "0",
    }
    return listening((str(python), "-m", _LISTEN, "tipg.main:app"), environment, server.pid)


@contextmanager
def _pygeoapi(python: Path, server: PostGis, database: str, folder: Path) -> Iterator[Measured]:
    settings, description = folder / "pygeoapi.json", folder / "pygeoapi-openapi.json"
    # YAML takes JSON.
    settings.write_text(json.dumps(pygeoapi_settings(server.sockets, database)))
    environment = {"PYGEOAPI_CONFIG": str(settings), "PYGEOAPI_OPENAPI": str(description)}
    program = str(python.parent / "pygeoapi")
    made = subprocess.run(  # noqa: S603  # our own arguments
        [program, "openapi", "generate", str(settings), "--format", "json", "--output-file", str(description)],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    if made.returncode:
        raise AbsentError(f"pygeoapi openapi generate: {(made.stderr or made.stdout).strip().splitlines()[-1]}")
    with listening((str(python), "-m", _LISTEN, "pygeoapi.starlette_app:APP"), environment, server.pid) as measured:
        yield measured


def pygeoapi_settings(sockets: Path, database: str) -> Mapping[str, object]:
    """What pygeoapi wants to know: one collection from one table."""
    limits = {"default_items": _LIMIT, "max_items": _LIMIT}
    provider = {
        "type": "feature",
        "name": "PostgreSQL",
        "data": {
            "host": str(sockets),
            "port": 5432,
            "dbname": database,
            "user": "postgres",
            "password": "none",
            "search_path": ["public"],
        },
        "id_field": "id",
        "table": FEATURES,
        "geom_field": "geom",
        "storage_crs": _EPSG_4326,
        "crs": [_EPSG_4326],
    }
    collection = {
        "type": "collection",
        "title": FEATURES,
        "description": FEATURES,
        "keywords": ["obstacles"],
        "links": [],
        "extents": {"spatial": {"bbox": [-180, -90, 180, 90]}},
        "providers": [provider],
    }
    return {
        "server": {
            "bind": {"host": "127.0.0.1", "port": 5000},
            "url": "http://127.0.0.1:5000",
            "mimetype": "application/json; charset=UTF-8",
            "encoding": "utf-8",
            "languages": ["en-US"],
            "limits": limits,
            "map": {"url": "http://127.0.0.1/{z}/{x}/{y}.png", "attribution": "none"},
        },
        "logging": {"level": "ERROR"},
        "metadata": {
            "identification": {
                "title": "peer",
                "description": "peer",
                "keywords": ["peer"],
                "terms_of_service": "none",
                "url": "http://127.0.0.1",
            },
            "license": {"name": "none", "url": "http://127.0.0.1"},
            "provider": {"name": "none", "url": "http://127.0.0.1"},
            "contact": {"name": "none"},
        },
        "resources": {FEATURES: collection},
    }


PEERS = (
    Peer("PostGIS by hand", "asyncpg", circle_path, _by_hand),
    Peer("tipg, a box", "tipg", _tipg_path, _tipg),
    Peer("pygeoapi, a box", "pygeoapi", _pygeoapi_path, _pygeoapi),
)
