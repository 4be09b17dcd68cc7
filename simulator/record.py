"""A scenario driven and written down: each vehicle in a process of its own, the same bytes from the same plan."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures import wait as wait_for
from dataclasses import dataclass
from datetime import UTC, datetime
from multiprocessing.sharedctypes import SynchronizedArray
from pathlib import Path

from simulator.changes import Worlds
from simulator.drive import Drive, tick_of
from simulator.recording.header import RecordingHeader
from simulator.recording.writer import EgoSummary, EgoWriter, begin_recording, end_recording
from simulator.scenario import Scenario, ScenarioPlan, scenario
from simulator.sensor_config import SensorRig, read_sensors
from simulator.world import World

POLL_S = 0.2

START = datetime(2025, 6, 15, 10, 0, tzinfo=UTC)
"""The world's time 0, fixed: a recording's bytes follow from its plan alone."""

Progress = Callable[[list[int]], None]
"""Told how many frames of each ego are written."""


@dataclass(frozen=True, slots=True)
class RecordingPlan:
    """A scenario, the sensors of every ego as in `sensors.json`, when it happens, and whether MCAP files are wanted."""

    scenario: ScenarioPlan
    sensors: Sequence[Mapping[str, object]]
    start: datetime = START
    mcap: bool = True

    @property
    def rig(self) -> SensorRig:
        """The sensors, checked."""
        return read_sensors({"sensors": list(self.sensors)})

    @property
    def frames(self) -> int:
        """Frames of each ego."""
        return int(self.scenario.seconds / tick_of(self.rig) + 1e-6)


def record(plan: RecordingPlan, folder: Path, progress: Progress) -> Scenario:
    """Drive and write a whole recording. RecordingError and OSError say what is wrong with the folder."""
    happening = scenario(plan.scenario)
    header = _header(plan, happening)
    truth = happening.changing.truth()
    begin_recording(folder, header, truth)
    egos = len(happening.egos)
    context = multiprocessing.get_context("spawn")
    written = context.Array("i", egos)
    workers = min(egos, os.cpu_count() or 1)
    with ProcessPoolExecutor(workers, context, initializer=_share, initargs=(written,)) as pool:
        drives = [pool.submit(_drive, plan, folder, ego) for ego in range(egos)]
        try:
            while wait_for(drives, timeout=POLL_S).not_done:
                progress(written[:])
                if any(drive.done() and drive.exception() for drive in drives):
                    break
            summaries = [drive.result() for drive in drives]
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
    progress(written[:])
    end_recording(folder, header, summaries)
    return happening


_written: SynchronizedArray[int] | None = None
"""In a worker: frames written by each ego, shared with the process that shows the progress."""


def _share(written: SynchronizedArray[int]) -> None:
    global _written
    _written = written


def _drive(plan: RecordingPlan, folder: Path, ego: int) -> EgoSummary:
    """Drive and write one vehicle, in a worker."""
    happening = scenario(plan.scenario)
    drive = drive_of(happening, ego, plan.rig)
    header, truth = _header(plan, happening), happening.changing.truth()
    with EgoWriter(folder, ego, header, truth, mcap=plan.mcap) as recording:
        for count, frame in enumerate(drive, start=1):
            recording.write(frame)
            if _written is not None:
                _written[ego] = count
    return recording.summary


def drive_of(happening: Scenario, ego: int, rig: SensorRig) -> Drive:
    """The drive of one ego through a scenario."""
    worlds = Worlds(happening.changing, lambda street: World(street, happening.movers, happening.daylight))
    plan = happening.plan
    return Drive(worlds, happening.egos[ego], rig, seed=plan.seed, seconds=plan.seconds)


def _header(plan: RecordingPlan, happening: Scenario) -> RecordingHeader:
    street = happening.changing.street
    return RecordingHeader(
        made_by="headsup simulate drive",
        seed=plan.scenario.seed,
        start=plan.start,
        tick_s=tick_of(plan.rig),
        georeference=street.georeference,
        enu_from_street=street.enu_from_street,
        sensors=plan.sensors,
    )
