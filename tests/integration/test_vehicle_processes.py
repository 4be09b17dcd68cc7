"""`headsup drive` and its process: whichever is told to end, or is killed, the other does what it should."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import psutil
import pytest

from tests.unit.vehicle_client.positioning.test_odometry import yard

PATIENCE_S = 120
"""A guard against hanging, not a measurement."""

HEIGHT_M = 1.7
SWEEPS = 1_000
WORKER = "vehicle_client.positioning.matching_worker"


@pytest.fixture
def sweeps(tmp_path: Path) -> Path:
    """A hundred seconds of a car that stands: nothing but sweeps, so that they are matched."""
    folder = tmp_path / "sweeps"
    folder.mkdir()
    seen = yard() - [0.0, 0.0, HEIGHT_M]
    np.column_stack([seen, np.zeros(len(seen))]).astype("<f4").tofile(folder / "0000.bin")
    for number in range(1, SWEEPS):
        (folder / f"{number:04d}.bin").symlink_to(folder / "0000.bin")
    return folder


@contextmanager
def driving(*arguments: str | Path) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "headsup.cli", "drive", *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def until(happened: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not happened():
        assert time.monotonic() < deadline_s
        time.sleep(0.05)


def worker_of(process: subprocess.Popen[str], *, other_than: int = 0) -> int:
    found: list[int] = []

    def look() -> bool:
        children = psutil.Process(process.pid).children()
        found.extend(child.pid for child in children if child.pid != other_than and WORKER in child.cmdline())
        return bool(found)

    until(look)
    return found[0]


def is_gone(pid: int) -> bool:
    return not psutil.pid_exists(pid) or psutil.Process(pid).status() == psutil.STATUS_ZOMBIE


def test_a_drive_outlives_its_matching_and_ends_in_order_with_it(sweeps: Path, tmp_path: Path) -> None:
    counts, recording = tmp_path / "counts.json", tmp_path / "drive.mcap"
    arguments = (sweeps, "--sensor-height", str(HEIGHT_M), "--realtime", "--json", counts, "--record", recording)
    with driving(*arguments) as process:
        begun = tmp_path / "drive.mcap.part"
        until(lambda: begun.exists() and begun.stat().st_size > 0)
        killed = worker_of(process)
        os.kill(killed, signal.SIGKILL)
        second = worker_of(process, other_than=killed)
        process.send_signal(signal.SIGTERM)
        _, errors = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, errors
    assert "scan matching broke off: odometry begins anew" in errors
    said = json.loads(counts.read_text())
    assert said["frames"] > 0
    assert (said["faults"], said["broken_off"]) == (0, None)
    assert is_gone(killed)
    assert is_gone(second)


def test_a_drive_that_is_killed_leaves_no_process_behind(sweeps: Path) -> None:
    with driving(sweeps, "--sensor-height", str(HEIGHT_M), "--realtime") as process:
        worker = worker_of(process)
        process.kill()
        process.wait()
    until(lambda: is_gone(worker))


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_drive_that_is_told_to_end_while_it_waits_for_its_sensor_ends_in_order(
    number: signal.Signals, tmp_path: Path
) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    counts = tmp_path / "counts.json"
    with driving(f"udp://127.0.0.1:{port}", "--json", counts) as process:
        until(lambda: any(c.laddr.port == port for c in psutil.Process(process.pid).net_connections("udp")))
        process.send_signal(number)
        out, errors = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, errors) == (0, "")
    assert "frames" in out
    assert json.loads(counts.read_text())["frames"] == 0
