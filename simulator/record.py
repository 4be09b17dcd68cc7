"""A scenario driven and written down: each vehicle in a process of its own, the same bytes from the same plan."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures import wait as wait_for
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from importlib.metadata import version
from multiprocessing.sharedctypes import SynchronizedArray
from multiprocessing.synchronize import Event
from pathlib import Path

from simulator.changes import Worlds
from simulator.drive import Drive, tick_of
from simulator.fingerprint import plain
from simulator.overview.sights import Onlooker, Sight, moments
from simulator.readings import EgoFrame
from simulator.recording.files import RecordingError, write_whole
from simulator.recording.header import RecordingHeader
from simulator.recording.writer import EgoSummary, EgoWriter, begin_recording, end_recording, refuse_full
from simulator.scenario import Scenario, ScenarioPlan, scenario
from simulator.sensors.sensor_config import SensorRig, read_sensors
from simulator.world import World

POLL_S = 0.2

START = datetime(2025, 6, 15, 10, 0, tzinfo=UTC)
"""The world's time 0, fixed: a recording's bytes follow from its plan alone."""

Progress = Callable[[list[int]], None]
"""Told how many frames of each ego are written; what it raises ends the recording."""


class StoppedError(RuntimeError):
    """A vehicle's recording ended early because another one's did."""


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
    def asked(self) -> dict[str, object]:
        """What the bytes follow from besides seed, sensors and start, in plain values."""
        asked = {field.name: plain(getattr(self.scenario, field.name)) for field in fields(self.scenario)}
        world = {field.name: plain(getattr(self.scenario.world, field.name)) for field in fields(self.scenario.world)}
        # The one is stated by itself, the other follows from the time that is driven.
        del asked["seed"], world["length_m"]
        asked["map_file"] = self.scenario.map_file.named if self.scenario.map_file is not None else None
        return {"headsup": version("headsup"), **asked, "world": world, "mcap": self.mcap}

    @property
    def frames(self) -> int:
        """Frames of each ego."""
        return int(self.scenario.seconds / tick_of(self.rig) + 1e-6)


def record(plan: RecordingPlan, folder: Path, progress: Progress) -> Scenario:
    """Drive and write a whole recording. RecordingError and OSError say what is wrong with the folder."""
    if plan.frames < 1:
        raise RecordingError(f"{plan.scenario.seconds:g} s are less than one frame of {tick_of(plan.rig):g} s")
    refuse_full(folder)
    happening = scenario(plan.scenario)
    header = _header(plan, happening)
    truth = happening.changing.truth()
    begin_recording(folder, header, truth)
    summaries = _drive_all(plan, folder, len(happening.egos), progress)
    end_recording(folder, header, summaries)
    return happening


def _drive_all(plan: RecordingPlan, folder: Path, egos: int, progress: Progress) -> list[EgoSummary]:
    """Every vehicle in a process, then their overview in one of them."""
    context = multiprocessing.get_context("spawn")
    written, stop = context.Array("i", egos), context.Event()
    workers = min(egos, os.cpu_count() or 1)
    with ProcessPoolExecutor(workers, context, initializer=_share, initargs=(written, stop)) as pool:
        drives = [pool.submit(_drive, plan, folder, ego) for ego in range(egos)]
        try:
            while wait_for(drives, timeout=POLL_S).not_done:
                progress(written[:])
                for drive in drives:
                    if drive.done():
                        drive.result()
            progress(written[:])
            summaries, sights = zip(*(drive.result() for drive in drives), strict=True)
            pool.submit(_draw_overview, plan, folder, [sight for some in sights for sight in some]).result()
            return list(summaries)
        except BrokenProcessPool:
            raise RecordingError("a vehicle's process was ended from outside: is there enough memory?") from None
        finally:
            stop.set()


@dataclass(frozen=True, slots=True)
class _Shared:
    """What a worker has in common with the process that started it: frames written by each ego, and whether to stop."""

    written: SynchronizedArray[int]
    stop: Event

    def tell(self, ego: int, count: int) -> None:
        """Say how far one ego is. `StoppedError` if there is nobody left to go on for."""
        self.written[ego] = count
        parent = multiprocessing.parent_process()
        if self.stop.is_set() or (parent is not None and not parent.is_alive()):
            raise StoppedError("another vehicle's recording has ended, or the command has")


_shared: _Shared | None = None


def _share(written: SynchronizedArray[int], stop: Event) -> None:
    global _shared
    # Ctrl-C reaches every process of a terminal; the one that was started by hand tells the others.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _shared = _Shared(written, stop)


def _drive(plan: RecordingPlan, folder: Path, ego: int) -> tuple[EgoSummary, list[Sight]]:
    """Drive and write one vehicle, in a worker: a frame is written while the next one is simulated."""
    happening = scenario(plan.scenario)
    worlds, rig = worlds_of(happening), plan.rig
    drive = drive_of(happening, ego, rig, worlds)
    chosen = [moment for moment in moments(happening, tick_of(rig)) if moment.ego == ego]
    onlooker = Onlooker(chosen, rig, worlds, happening.egos[ego].mover)
    header, truth = _header(plan, happening), happening.changing.truth()
    with EgoWriter(folder, ego, header, truth, mcap=plan.mcap) as recording, _beside(recording.write) as write:
        for count, frame in enumerate(drive, start=1):
            write(frame)
            onlooker.look(frame)
            if _shared is not None:
                _shared.tell(ego, count)
    return recording.summary, onlooker.sights


def _draw_overview(plan: RecordingPlan, folder: Path, sights: Sequence[Sight]) -> None:
    from simulator.overview.figure import overview

    write_whole(folder / "overview.png", overview(scenario(plan.scenario), sights))


@contextmanager
def _beside(write: Callable[[EgoFrame], None]) -> Iterator[Callable[[EgoFrame], None]]:
    """Writing in a thread of its own, in order, at most one frame late; a failure comes with the next frame."""
    with ThreadPoolExecutor(1) as thread:
        latest: list[Future[None]] = []

        def hand_over(frame: EgoFrame) -> None:
            if latest:
                latest.pop().result()
            latest.append(thread.submit(write, frame))

        yield hand_over
        for last in latest:
            last.result()


def worlds_of(happening: Scenario) -> Worlds:
    """The street and what moves through it, at any time."""
    return Worlds(happening.changing, lambda street: World(street, happening.movers, happening.daylight))


def drive_of(happening: Scenario, ego: int, rig: SensorRig, worlds: Worlds | None = None) -> Drive:
    """The drive of one ego through a scenario, in worlds of its own or given ones."""
    plan, worlds = happening.plan, worlds or worlds_of(happening)
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
        asked=plan.asked,
    )
