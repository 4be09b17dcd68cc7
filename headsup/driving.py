"""A drive from what was asked on the command line: source, calibration, server and recording put together."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from itertools import chain, islice
from pathlib import Path
from secrets import token_hex

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from contract.geometry import LatLon
from headsup.ending import EndedEarly, Ending
from vehicle_client.drive import Step, Vehicle
from vehicle_client.frames import GeoOrigin, rigid
from vehicle_client.link.background import BackgroundLink
from vehicle_client.link.http_asking import API_KEY_VARIABLE, UnusableError
from vehicle_client.link.map_store import MapStore
from vehicle_client.link.nobody import NobodyLink
from vehicle_client.link.outbox import OutboxError
from vehicle_client.link.server_link import LinkStatus, ServerLink
from vehicle_client.obstacle_map import ObstacleMap
from vehicle_client.pacing import Paced, Ready
from vehicle_client.positioning.pose import PoseFilter, StatedPlace
from vehicle_client.positioning.pose_filter import DELAY_SD_S, KNOWN_DELAY_SD_S
from vehicle_client.privacy.pseudonym import Pseudonyms
from vehicle_client.privacy.quiet_zones import ZoneError, read_zones
from vehicle_client.privacy.report_privacy import Privacy
from vehicle_client.recording.background_recorder import BackgroundRecorder
from vehicle_client.recording.drive_recorder import DriveRecorder, RecordingError
from vehicle_client.sensing.calibration import VehicleCalibration
from vehicle_client.sensing.calibration_file import CalibrationError, CarCalibration, read_calibration
from vehicle_client.sensing.height_estimate import TRIED_FRAMES, estimated_height_m
from vehicle_client.session import Known, Listener, Preparing, drive_along, windshield
from vehicle_client.sources.frame import LidarFrame, SourceError
from vehicle_client.sources.opening import CountingSource, SourceOptions, open_source
from vehicle_client.sources.shifting import begun_at
from vehicle_client.totals import Totals
from vehicle_client.warming import load_compiled

FAST_DRIVE_S = 3 * 3600.0
"""A recording that is driven through faster than it was made must not run into the future: it begins so long ago."""


class DriveError(ValueError):
    """The drive cannot be made as it was asked for; the message says what to do."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """What the command line says."""

    source: str
    calibration: Path | None = None
    sensor_height_m: float | None = None
    rate_hz: float = 10.0
    ego: int = 0
    topics: tuple[str, ...] = ()
    start: str | None = None
    server: str | None = None
    realtime: bool | None = None
    record: Path | None = None
    state: Path | None = None
    quiet_zones: Path | None = None
    as_if_now: bool = False

    @property
    def is_live(self) -> bool:
        """Whether a sensor sends, rather than a file."""
        return "://" in self.source

    @property
    def is_realtime(self) -> bool:
        """Whether the sensor's pace is kept."""
        return self.is_live if self.realtime is None else self.realtime


@dataclass(frozen=True, slots=True)
class Outcome:
    """What the drive came to."""

    asked: Asked
    totals: Totals
    skipped: int
    """Frames, pictures and lines that the source could not use."""
    dropped: int
    """Frames that came faster than they were taken."""
    stalls: int
    """How often the recording could not be read at its pace."""
    link: LinkStatus | None
    recording_stopped: str | None


def run(asked: Asked) -> Outcome:
    """Make the drive. Raises `DriveError` or `OSError`.

    Told to end before it has begun, also while nobody knows how high the sensor is, it has come to nothing.
    """
    try:
        with Ending() as ending:
            return _run(asked, ending)
    except EndedEarly:
        return Outcome(asked, Totals(), skipped=0, dropped=0, stalls=0, link=None, recording_stopped=None)
    except (SourceError, CalibrationError, RecordingError, OutboxError, UnusableError, ZoneError) as error:
        raise DriveError(str(error)) from error


def _run(asked: Asked, ending: Ending) -> Outcome:
    source = open_source(asked.source, SourceOptions(asked.rate_hz, ego=asked.ego, topics=_topics(asked.topics)))
    frames: Iterator[LidarFrame] = iter(source)
    if asked.as_if_now:
        frames = begun_at(frames, time.time() - (0.0 if asked.is_realtime else FAST_DRIVE_S))
    car, frames = _car(asked, frames)
    totals = Totals()
    with ExitStack() as stack:
        link = _link(asked, stack)
        store = None if asked.server is None else MapStore(_state_folder(asked) / "map.gz")
        vehicle = Vehicle(
            car.vehicle,
            NobodyLink() if link is None else link,
            pseudonym=f"v-{token_hex(8)}",
            known=ObstacleMap() if store is None else store.load(),
            pose_filter=PoseFilter(
                antenna_m=car.antenna_m,
                delay_sd_s=DELAY_SD_S if car.delays.gnss_s is None else KNOWN_DELAY_SD_S,
                stated=_stated(asked.start),
            ),
        )
        recorder = _recorder(asked, car, stack)
        listeners: list[Listener] = [_progress(stack, source)]
        if recorder is not None:
            listeners.append(_recording(recorder, car))
        if store is not None:
            listeners.append(lambda step, _: store.save_if_due(step.known, step.frame.stamp_s))
        if asked.is_realtime:
            _load_compiled()
        preparing = stack.enter_context(Preparing(car, realtime=asked.is_realtime))
        paced = stack.enter_context(
            Paced[Known](frames, preparing, realtime=asked.is_realtime, is_recorded=not asked.is_live)
        )
        ending.calls(paced.stop)
        last = drive_along(paced, vehicle, totals, listeners)
        if store is not None and last is not None:
            store.save(vehicle.known, last.frame.stamp_s)
        status = None if link is None else link.status
    if isinstance(link, BackgroundLink) and status is not None:
        # What the end of the link still brought.
        totals.add_answers(link.deliver())
        status = replace(status, waiting=link.status.waiting, fates=link.status.fates)
    return Outcome(
        asked,
        totals,
        source.skipped,
        paced.dropped,
        paced.stalls,
        status,
        None if recorder is None else recorder.stopped,
    )


def _load_compiled() -> None:
    """No sweep waits for what is compiled: on a new machine its first use takes a minute."""
    with Console(stderr=True).status("loading what is compiled; the first time it is compiled, for a minute"):
        load_compiled()


def _topics(given: Sequence[str]) -> dict[str, str]:
    """Topics by role; an empty name takes none."""
    if wrong := [item for item in given if "=" not in item]:
        raise DriveError(f"--topic {wrong[0]}: expected ROLE=TOPIC, such as sweep=/lidar/points, or ROLE= for none")
    return dict(item.partition("=")[::2] for item in given)


def _car(asked: Asked, frames: Iterator[LidarFrame]) -> tuple[CarCalibration, Iterator[LidarFrame]]:
    """The calibration, and the frames with those that it took to find the sensor's height."""
    if asked.calibration is not None:
        if asked.sensor_height_m is not None:
            raise DriveError("--sensor-height: the calibration file says it; give one of both")
        return read_calibration(asked.calibration), frames
    seen: list[LidarFrame] = []
    height_m = asked.sensor_height_m
    if height_m is None:
        seen = list(islice(frames, TRIED_FRAMES))
        height_m = estimated_height_m(seen)
    if height_m is None:
        raise DriveError("how high the LiDAR sits above the road cannot be told: give --calibration or --sensor-height")
    vehicle_from_sensor = rigid(np.eye(3), np.array([0.0, 0.0, height_m]))
    return CarCalibration(VehicleCalibration(vehicle_from_sensor, sensor="lidar")), chain(seen, frames)


def _stated(start: str | None) -> StatedPlace | None:
    if start is None:
        return None
    try:
        latitude_deg, longitude_deg, altitude_m, heading_deg = (float(word) for word in start.split(","))
        if not math.isfinite(altitude_m + heading_deg):
            raise ValueError("neither infinite nor no number")
        origin = GeoOrigin(LatLon(latitude_deg=latitude_deg, longitude_deg=longitude_deg), altitude_m)
    except ValueError as error:
        raise DriveError(
            "--start: expected LAT,LON,ALT,HEADING in degrees and metres, such as 49.01,8.43,115,90"
        ) from error
    return StatedPlace(origin, float(np.radians(heading_deg)))


def _state_folder(asked: Asked) -> Path:
    folder = asked.state
    if folder is None:
        folder = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "headsup"
    # What waits there says where the car was.
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    return folder


def _link(asked: Asked, stack: ExitStack) -> ServerLink | BackgroundLink | None:
    if asked.server is None:
        return None
    key = os.environ.get(API_KEY_VARIABLE)
    zones = () if asked.quiet_zones is None else read_zones(asked.quiet_zones)
    # Without a key the server takes the name for the vehicle: it must not change.
    privacy = Privacy(zones, Pseudonyms() if key else None)
    link = ServerLink(asked.server, key, _state_folder(asked) / "outbox.sqlite3", privacy=privacy)
    if not asked.is_realtime:
        return stack.enter_context(link)
    return stack.enter_context(BackgroundLink(link))


def _recorder(asked: Asked, car: CarCalibration, stack: ExitStack) -> DriveRecorder | BackgroundRecorder | None:
    if asked.record is None:
        return None
    recorder = DriveRecorder(asked.record, car.vehicle)
    if not asked.is_realtime:
        return stack.enter_context(recorder)
    return stack.enter_context(BackgroundRecorder(recorder))


def _recording(recorder: DriveRecorder | BackgroundRecorder, car: CarCalibration) -> Listener:
    if isinstance(recorder, BackgroundRecorder):
        return lambda step, ready: recorder.add(step, lambda: windshield(step, ready, car), ready.frame)
    return lambda step, ready: recorder.add(step, windshield(step, ready, car), ready.frame)


def _progress(stack: ExitStack, source: CountingSource) -> Listener:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    bar = stack.enter_context(Progress(*columns, console=Console(stderr=True), transient=True))
    task = bar.add_task("driving", total=len(source) or None)

    def show(step: Step, _: Ready[Known]) -> None:
        bar.update(task, advance=1, description="driving" if step.reason is None else f"driving ({step.reason})")

    return show
