"""The peers that can be run here, beside the service; one that cannot is a line in the report."""

from __future__ import annotations

import asyncio
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from benchmarks import peer_data
from benchmarks.peer_postgis import AbsentError, PostGis, postgis
from benchmarks.peer_servers import PEERS, Peer
from benchmarks.server_answers import found
from benchmarks.server_data import RADIUS_M
from benchmarks.server_processes import Measured
from benchmarks.server_report import Report, Stock
from benchmarks.server_turns import bar


@dataclass(frozen=True, slots=True)
class Beside:
    """A peer that runs."""

    peer: Peer
    version: str
    server: Measured

    def __str__(self) -> str:
        return f"{self.peer.package} {self.version}"


@contextmanager
def peers_beside(venv: Path | None, stock: Stock, report: Report) -> Iterator[list[Beside]]:
    """The peers of a virtual environment on a PostGIS with the obstacles of `stock`; none without an environment."""
    with ExitStack() as stack:
        try:
            python, server = _stocked(venv, stock, stack)
        except AbsentError as error:
            report.note(f"Peers not run: {error}")
            yield []
            return
        started = (_started(peer, python, server, stock, report, stack) for peer in PEERS)
        running = [beside for beside in started if beside is not None]
        if running:
            report.note(f"Peers, on PostgreSQL 15 with PostGIS: {', '.join(map(str, running))}.")
        yield running


def _stocked(venv: Path | None, stock: Stock, stack: ExitStack) -> tuple[Path, PostGis]:
    """A Python of the peers, and a PostGIS with a database that holds the obstacles."""
    python = _python(venv)
    server = stack.enter_context(postgis(stock.folder))
    name = _database(stock)
    asyncio.run(peer_data.create(server.url("postgres"), name))
    with bar() as progress:
        task = progress.add_task("obstacles to PostGIS", total=None)
        asyncio.run(
            peer_data.fill(
                stock.url.replace("+asyncpg", ""),
                server.url(name),
                lambda total, done: progress.update(task, total=total, completed=done),
            )
        )
    return python, server


def _database(stock: Stock) -> str:
    return f"obstacles_{len(stock.places_deg)}"


def _python(venv: Path | None) -> Path:
    if venv is None:
        raise AbsentError("no environment of theirs was given (--peers VENV)")
    python = venv.absolute() / "bin" / "python"
    if not python.exists():
        raise AbsentError(f"{venv} is not a virtual environment; benchmarks.server --help says how to make it")
    return python


def _started(
    peer: Peer, python: Path, server: PostGis, stock: Stock, report: Report, stack: ExitStack
) -> Beside | None:
    try:
        version = _version(python, peer.package)
        running = stack.enter_context(peer.start(python, server, _database(stock), stock.folder))
        latitude_deg, longitude_deg = map(float, stock.places_deg[0])
        if not found(running.url + peer.path_of(latitude_deg, longitude_deg, RADIUS_M)):
            raise AbsentError("it finds nothing at the place of an obstacle")
    except (RuntimeError, OSError, ValueError) as error:
        report.note(f"{peer.name} not run: {error}")
        return None
    return Beside(peer, version, running)


def _version(python: Path, package: str) -> str:
    program = f"from importlib.metadata import version; print(version({package!r}))"
    ran = subprocess.run([python, "-c", program], capture_output=True, text=True, check=False)  # noqa: S603  # our own
    if ran.returncode:
        raise AbsentError(f"{package} is not installed there; benchmarks.server --help says how")
    return ran.stdout.strip()
