"""PostgreSQL 15 with PostGIS 3 from Debian, for the peers that stand on it, beside the service's own PostgreSQL 18."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

_PROGRAMS = Path("/usr/lib/postgresql/15/bin")
_EXTENSION = Path("/usr/share/postgresql/15/extension/postgis.control")
# The service keeps a million obstacles in its process, in 1.2 GiB: this one may keep as much in its own memory.
_SHARED_BUFFERS = "1GB"
# PostgreSQL refuses to run as root; the service's own one has made this user by then.
_USER = "embedded_postgres"


class AbsentError(RuntimeError):
    """A peer cannot be run here; the message says why and what would help."""


@dataclass(frozen=True, slots=True)
class PostGis:
    """A running server that listens on a socket in `sockets` only, for the user `postgres`."""

    sockets: Path
    pid: int

    def url(self, database: str) -> str:
        """Where a driver finds a database."""
        return f"postgresql://postgres@{quote(str(self.sockets), safe='')}:5432/{database}"


@contextmanager
def postgis(folder: Path) -> Iterator[PostGis]:
    """A durable server (fsync on) whose data stay in `folder`; raises `AbsentError` when Debian's is not installed."""
    if not (_PROGRAMS / "postgres").exists() or not _EXTENSION.exists():
        raise AbsentError("PostGIS is not installed: apt-get install postgresql-15-postgis-3")
    data = folder / "postgis"
    # The path of a socket holds 107 bytes at most; that of `folder` may be longer.
    with tempfile.TemporaryDirectory(prefix="headsup-postgis-") as temporary:
        sockets = Path(temporary)
        _own(sockets)
        if not (data / "PG_VERSION").exists():
            _make(data)
        _run("pg_ctl", "-D", data, "-w", "-l", data / "log", "-o", _settings(sockets), "start")
        try:
            yield PostGis(sockets, int((data / "postmaster.pid").read_text().split()[0]))
        finally:
            _run("pg_ctl", "-D", data, "-w", "-m", "fast", "stop")


def _settings(sockets: Path) -> str:
    return f"-h '' -k {sockets} -c shared_buffers={_SHARED_BUFFERS} -c max_wal_size=4GB"


def _make(data: Path) -> None:
    # What is there was left by a run that was broken off.
    shutil.rmtree(data, ignore_errors=True)
    data.mkdir()
    _own(data)
    _run("initdb", "-D", data, "-U", "postgres", "--auth=trust", "--encoding=UTF8", "--locale=C.UTF-8")


def _own(folder: Path) -> None:
    if os.geteuid() == 0:
        shutil.chown(folder, _USER, _USER)


def _run(program: str, *arguments: str | Path) -> None:
    ran = subprocess.run(  # noqa: S603  # our own arguments
        [_PROGRAMS / program, *arguments],
        # A pipe would stay open in the server that `pg_ctl` starts.
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        cwd="/",
        user=_USER if os.geteuid() == 0 else None,
        check=False,
    )
    if ran.returncode:
        raise AbsentError(f"{program} of PostgreSQL 15 failed; its log, if any: {arguments[1]}/log")
