"""The server as its own process on loopback, with one API key a car, as an operator would start it."""

from __future__ import annotations

import os
import queue
import re
import subprocess
import sys
import threading
from pathlib import Path
from types import TracebackType
from typing import IO

from headsup.demo.problem import DemoError

START_TIMEOUT_S = 60.0
"""A fresh machine compiles the server's modules once; that took up to 10 s on a slow disk."""

_LISTENING = re.compile(r"listening on (http://\S+)")


class ServerProcess:
    """`headsup serve` on a fresh SQLite database in `folder`, reached only over HTTP and WebSocket."""

    def __init__(self, folder: Path, log_path: Path) -> None:
        self._environment = {
            **{name: value for name, value in os.environ.items() if not name.startswith("HEADSUP_")},
            "HEADSUP_DATABASE_URL": f"sqlite+aiosqlite:///{folder / 'headsup.sqlite3'}",
        }
        self._log_path = log_path
        self._log: IO[bytes] = log_path.open("wb")
        self._process: subprocess.Popen[bytes] | None = None
        self.url = ""

    def create_key(self, name: str) -> str:
        """A vehicle's API key, made by `headsup keys create`."""
        done = subprocess.run(  # noqa: S603 - our own program, fixed arguments
            [sys.executable, "-m", "headsup.cli", "keys", "create", "--role", "vehicle", "--name", name],
            env=self._environment,
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode != 0:
            raise DemoError(f"no API key for {name}: {done.stderr.strip()}")
        return done.stdout.strip()

    def __enter__(self) -> ServerProcess:
        return self

    def start(self) -> None:
        """Start and wait until it says where it listens."""
        self._process = subprocess.Popen(
            [sys.executable, "-m", "headsup.cli", "serve", "--port", "0"],
            env=self._environment,
            stdout=subprocess.PIPE,
            stderr=self._log,
        )
        self.url = self._announced_url(self._process)

    @property
    def process_id(self) -> int:
        """Number of the server's process. Raises DemoError before `start`."""
        if self._process is None:
            raise DemoError("the server has not been started")
        return self._process.pid

    def ensure_alive(self) -> None:
        """Raise a clear error if the server has gone."""
        code = self._process.poll() if self._process is not None else None
        if code is not None:
            how = f"signal {-code}" if code < 0 else f"exit code {code}"
            raise DemoError(f"the server stopped in the middle of the demo ({how}); its log is {self._log_path}")

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process is not None:
            self._process.terminate()
            try:
                self._process.wait(timeout=10)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._log.close()

    def _announced_url(self, process: subprocess.Popen[bytes]) -> str:
        lines: queue.Queue[str | None] = queue.Queue()
        threading.Thread(target=_pass_on, args=(process, lines), daemon=True).start()
        try:
            while (line := lines.get(timeout=START_TIMEOUT_S)) is not None:
                if found := _LISTENING.search(line):
                    return found.group(1)
        except queue.Empty:
            raise DemoError(f"the server did not start in {START_TIMEOUT_S:.0f} s; see {self._log_path}") from None
        raise DemoError(f"the server did not start; {self._log_path} says why")


def _pass_on(process: subprocess.Popen[bytes], lines: queue.Queue[str | None]) -> None:
    """Read all that the server prints, so that its pipe never fills; None marks the end."""
    if process.stdout is not None:
        for line in process.stdout:
            lines.put(line.decode(errors="replace"))
    lines.put(None)
