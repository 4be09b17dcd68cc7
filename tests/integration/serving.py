"""The server as a process of its own, with its log: for the tests of operation."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx

_PROGRAM = (sys.executable, "-m", "headsup.cli", "serve", "--port", "0")


@dataclass
class Served:
    """A running server."""

    process: subprocess.Popen[str]
    address: str
    log_path: Path

    @property
    def websocket(self) -> str:
        return f"{self.address.replace('http', 'ws', 1)}/v1/events"

    def client(self) -> httpx.Client:
        return httpx.Client(base_url=self.address, trust_env=False, timeout=30)

    def async_client(self) -> httpx.AsyncClient:
        return httpx.AsyncClient(base_url=self.address, trust_env=False, timeout=30)

    def log(self) -> str:
        return self.log_path.read_text()

    def told_to_end(self) -> None:
        self.process.send_signal(signal.SIGTERM)


@contextmanager
def served(database: Path, **environment: str) -> Iterator[Served]:
    """A server on a SQLite file, ended by SIGTERM and, if that does not help, killed."""
    log_path = database.with_suffix(".log")
    with log_path.open("w") as log:
        process = subprocess.Popen(
            _PROGRAM,
            env=_environment(HEADSUP_DATABASE_URL=f"sqlite+aiosqlite:///{database}", **environment),
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
        )
    with process:
        try:
            assert process.stdout is not None
            announced = process.stdout.readline().split()
            assert announced[:2] == ["listening", "on"], log_path.read_text()
            yield Served(process, announced[2], log_path)
            process.send_signal(signal.SIGTERM)
            process.wait(20)
        finally:
            process.kill()


def refused(**environment: str) -> str:
    """What a server that must not start says on standard error."""
    done = subprocess.run(_PROGRAM, env=_environment(**environment), capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    assert done.stdout == ""
    return done.stderr


def _environment(**environment: str) -> dict[str, str]:
    inherited = {name: value for name, value in os.environ.items() if not name.startswith("HEADSUP_")}
    return inherited | environment
