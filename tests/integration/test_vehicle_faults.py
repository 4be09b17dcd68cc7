"""The real client against the real server through a network that fails: the log ends with exactly what was put, and
the map with exactly what is served."""

from __future__ import annotations

import asyncio
import resource
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager, nullcontext
from datetime import UTC, datetime, timedelta
from pathlib import Path
from random import Random
from types import MappingProxyType
from uuid import UUID

import httpx
import pytest
import uvicorn

from contract.obstacle import ObstacleCollection
from server.app import create_app
from server.running import listening
from server.settings import Settings
from server.startup import preflight
from tests.integration.faulty_drive import along, link_to, report
from tests.integration.faulty_proxy import FAULTS, FaultyProxy
from tests.integration.processes import ServerProcess
from tests.unit.server.making import PATRAS
from vehicle_client.link.background import BackgroundLink
from vehicle_client.obstacle_map import ObstacleMap, apply, around

ROOT = Path(__file__).parents[2]
AGO = timedelta(hours=2)
PATIENCE_S = 60.0


class ServerThread:
    """The server in this process, on a port that it keeps."""

    def __init__(self, database: Path) -> None:
        self._settings = Settings(database_url=f"sqlite+aiosqlite:///{database}", port=0)

    @property
    def port(self) -> int:
        return self._settings.port

    def start(self) -> None:
        asyncio.run(preflight(self._settings))
        self._server = uvicorn.Server(listening(create_app(self._settings), self._settings))
        self._thread = threading.Thread(target=lambda: asyncio.run(self._server.serve()), daemon=True)
        self._thread.start()
        while not self._server.started:
            time.sleep(0.01)
        self._settings = self._settings.model_copy(update={"port": self._server.servers[0].sockets[0].getsockname()[1]})

    def stop(self) -> None:
        self._server.should_exit = True
        self._thread.join()


def log_of(database: Path) -> Counter[UUID]:
    """How often each report stands in the server's log."""
    with closing(sqlite3.connect(database)) as connection:
        return Counter(UUID(identifier) for (identifier,) in connection.execute("SELECT report_id FROM report"))


def expected(numbers: range, start: datetime) -> Counter[UUID]:
    return Counter(report(number, start).report_id for number in numbers)


class Drive:
    """What a drive makes of a link: it goes along, hears, and keeps a map."""

    def __init__(self) -> None:
        self.known = ObstacleMap()
        self.link: BackgroundLink

    def step(self, number: int) -> None:
        here, now_s = along(number), time.time()
        for said in self.link.hear(here):
            self.known = apply(self.known, said, now_s)
        self.known = around(self.known, here, now_s)

    def go_on_until(self, is_over: Callable[[], bool]) -> None:
        deadline_s = time.monotonic() + PATIENCE_S
        while not is_over():
            assert time.monotonic() < deadline_s, self.link.status
            self.step(0)
            time.sleep(0.02)

    def revisions(self) -> dict[UUID, int]:
        return {
            i: known.feature.properties.revision
            for i, known in (*self.known.obstacles.items(), *self.known.remembered.items())
        }


def served_revisions(port: int) -> dict[UUID, int]:
    where = {"lat": PATRAS.latitude_deg, "lon": PATRAS.longitude_deg}
    answer = httpx.get(f"http://127.0.0.1:{port}/v1/obstacles", params=where)
    features = ObstacleCollection.model_validate_json(answer.content).features
    return {feature.id: feature.properties.revision for feature in features}


@contextmanager
def no_disk() -> Iterator[None]:
    """No file of this process can be written to, the server's database among them."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def in_one_process(folder: Path, seed: int, count: int, restarts: int) -> None:
    random, start = Random(seed), datetime.now(UTC) - AGO  # noqa: S311  # not a secret
    server = ServerThread(folder / "headsup.sqlite3")
    server.start()
    events = sorted(random.sample(range(count), 2 * restarts))
    drive, outbox = Drive(), folder / "outbox.sqlite3"
    with FaultyProxy(server.port, random, faults=0.7) as proxy:
        with link_to(proxy.url, outbox, seed) as drive.link:
            for number in range(count):
                if number in events[::2]:
                    server.stop()
                if number in events[1::2]:
                    server.start()
                with no_disk() if number == count // 2 else nullcontext():
                    drive.link.put(report(number, start))
                drive.step(number)
                time.sleep(0.03)
            drive.go_on_until(lambda: set(proxy.done) >= set(FAULTS))
        proxy.faults = 0.0
        with link_to(proxy.url, outbox, seed) as drive.link:
            drive.go_on_until(lambda: not drive.link.status.waiting)
            fates = drive.link.status.fates
            revisions = served_revisions(server.port)
            drive.go_on_until(lambda: drive.revisions() == revisions)
    server.stop()
    assert sum(fates.values()) == fates.get("accepted", 0) + fates.get("duplicate", 0) == count
    assert log_of(folder / "headsup.sqlite3") == expected(range(count), start)


class Car:
    """The vehicle as a process that can be killed."""

    def __init__(self, url: str, outbox: Path, start: datetime) -> None:
        self._arguments = (url, str(outbox)), str(start.timestamp())
        self.put = 0
        self.is_done = False

    def drive(self, last: int, when_put: Mapping[int, Callable[[], None]] = MappingProxyType({})) -> None:
        """Put reports up to `last`, and do something each time that so many have been put."""
        before, after = self._arguments
        program = [sys.executable, "-m", "tests.integration.faulty_drive", *before, str(self.put), str(last), after]
        with subprocess.Popen(program, stdout=subprocess.PIPE, text=True, cwd=ROOT) as self._process:
            assert self._process.stdout is not None
            for line in self._process.stdout:
                if line.strip() == "done":
                    self.is_done = True
                else:
                    self.put = int(line) + 1
                    when_put.get(self.put, lambda: None)()

    def kill(self) -> None:
        self._process.send_signal(signal.SIGKILL)


def in_two_processes(folder: Path, seed: int, count: int, kills: int) -> None:
    random, start = Random(seed), datetime.now(UTC) - AGO  # noqa: S311  # not a secret
    server = ServerProcess(f"sqlite+aiosqlite:///{folder}/headsup.sqlite3")
    server.start()
    try:
        with FaultyProxy(server.port, random, faults=0.7) as proxy:
            car = Car(proxy.url, folder / "outbox.sqlite3", start)
            for _ in range(kills):
                server_s_end, car_s_end = sorted(random.sample(range(1, count // kills), 2))
                car.drive(count, {car.put + server_s_end: server.kill, car.put + car_s_end: car.kill})
                server.start()
            proxy.faults = 0.0
            car.drive(count)
        assert car.is_done
    finally:
        server.kill()
    assert log_of(folder / "headsup.sqlite3") == expected(range(count), start)


def test_in_one_process_log_and_map_end_as_they_should(tmp_path: Path) -> None:
    in_one_process(tmp_path, seed=1, count=60, restarts=2)


def test_in_two_processes_that_are_killed_the_log_ends_with_exactly_what_was_put(tmp_path: Path) -> None:
    in_two_processes(tmp_path, seed=3, count=60, kills=1)


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(100, 120))
def test_whatever_the_network_does_in_one_process(tmp_path: Path, seed: int) -> None:
    in_one_process(tmp_path, seed, count=300, restarts=4)


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(200, 210))
def test_whatever_the_network_and_the_processes_do(tmp_path: Path, seed: int) -> None:
    in_two_processes(tmp_path, seed, count=200, kills=8)
