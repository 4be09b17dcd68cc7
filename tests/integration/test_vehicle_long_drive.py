"""A quarter of an hour's sweeps through the whole loop against a real server: nothing grows, nothing is left over."""

from __future__ import annotations

import gc
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
import pytest

from headsup.demo.simulated import SimulatedSource, calibration, drive_on
from simulator.streets.street import first_light_street
from simulator.world import World
from tests.integration.serving import served
from vehicle_client.drive import Step, Vehicle
from vehicle_client.frames import GeoOrigin
from vehicle_client.link.background import BackgroundLink
from vehicle_client.link.server_link import ServerLink
from vehicle_client.pacing import Paced, Ready
from vehicle_client.sensing.calibration_file import CarCalibration
from vehicle_client.session import Known, Preparing, drive_along
from vehicle_client.sources.frame import LidarFrame
from vehicle_client.totals import Totals

FRAMES = 10_000
FRAME_S = 0.1
SPEED_MPS = 50 / 3.6
EVERY_THIRD = 3
"""Points that are taken: the proof is of the loop, and the detector's own time would make it an hour."""

MOST_GROWTH_BYTES = 8 * 2**20
"""Over 5,000 frames: a leak of one sweep in a hundred frames would be 5 MB, and the allocator breathes by a few."""


def block(seed: int) -> list[LidarFrame]:
    """150 m of street with four obstacles, without what only the first frame knows."""
    source = SimulatedSource(drive_on(World(first_light_street(seed, ())), 150.0, 304.0, SPEED_MPS, seed), 0.0)
    return [replace(f, points_m=np.ascontiguousarray(f.points_m[::EVERY_THIRD]), ring=None) for f in source]


def long_street(block: Sequence[LidarFrame], number: int, started_s: float) -> Iterator[LidarFrame]:
    """The block again and again, each time where the last one ended."""
    odom_m = [f.odom_from_vehicle[:3, 3] for f in block if f.odom_from_vehicle is not None]
    first_fix = block[0].gnss
    assert first_fix is not None
    origin = GeoOrigin(first_fix.position, first_fix.altitude_m)
    enu_m = [origin.enu(f.gnss.position, origin.altitude_m) for f in block if f.gnss is not None]
    longer = len(block) / (len(block) - 1)
    odom_shift_m, enu_shift_m = (longer * (places[-1] - places[0]) for places in (odom_m, enu_m))
    for index in range(number):
        lap, at = divmod(index, len(block))
        frame = block[at]
        assert frame.gnss is not None
        assert frame.odom_from_vehicle is not None
        odom_from_vehicle = frame.odom_from_vehicle.copy()
        odom_from_vehicle[:3, 3] += lap * odom_shift_m
        position, _ = origin.geodetic(origin.enu(frame.gnss.position, origin.altitude_m) + lap * enu_shift_m)
        fix = replace(frame.gnss, position=position)
        yield replace(frame, stamp_s=started_s + FRAME_S * index, odom_from_vehicle=odom_from_vehicle, gnss=fix)


@pytest.mark.soak
def test_ten_thousand_frames_leave_memory_threads_and_files_as_they_were(tmp_path: Path) -> None:
    process, frames = psutil.Process(), block(seed=1)
    resident: list[int] = []

    def measure(step: Step, _: Ready[Known]) -> None:
        if totals.frames % 1_000 == 0:
            gc.collect()
            resident.append(process.memory_info().rss)

    totals, car = Totals(), CarCalibration(calibration())
    with served(tmp_path / "server.sqlite3") as server:
        before = threading.active_count(), process.num_fds()
        with BackgroundLink(ServerLink(server.address, None, tmp_path / "outbox.sqlite3")) as link:
            vehicle = Vehicle(car.vehicle, link, pseudonym="long-drive")
            source = long_street(frames, FRAMES, time.time() - FRAMES * FRAME_S - 60)
            with Paced[Known](source, Preparing(car, realtime=False), realtime=False, is_recorded=True) as paced:
                drive_along(paced, vehicle, totals, [measure])
        after = threading.active_count(), process.num_fds()
        assert link.status.waiting == 0
        assert link.status.fates == {"accepted": totals.reports}
    laps = FRAMES // len(frames)
    assert (totals.frames, totals.placed, totals.faults, totals.unusable) == (FRAMES, FRAMES, 0, 0)
    assert totals.reports >= laps
    assert len(vehicle.known.obstacles) <= 2 * 4 * laps
    assert vehicle.waiting == 0
    assert after == before
    assert resident[-1] - resident[len(resident) // 2 - 1] < MOST_GROWTH_BYTES
