"""Recordings of several vehicles, written frame by frame.

with RecordingWriter(folder, header, egos=2, obstacles=truth) as recording:
    for frame in frames:
        recording.write(ego, frame)
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from types import TracebackType

from simulator.readings import EgoFrame, ImageReading, ObstacleTruth
from simulator.recording.carla_layout import EgoFolder
from simulator.recording.files import RecordingError, json_bytes, png_bytes, write_whole
from simulator.recording.header import RecordingHeader, sensor_folders
from simulator.recording.mcap_file import McapFile


@dataclass(frozen=True, slots=True)
class EgoSummary:
    """What one vehicle's part of a recording holds: its folder, and its frames' numbers."""

    folder: str
    frames: int
    first: int | None
    last: int | None


class EgoWriter:
    """One vehicle's folder and MCAP file: a process may write one while another writes the next."""

    def __init__(
        self, run: Path, ego: int, header: RecordingHeader, obstacles: Sequence[ObstacleTruth], *, mcap: bool = True
    ) -> None:
        self._name = f"ego{ego}"
        self._folders = sensor_folders(header.sensors)
        self._numbers: list[int] = []
        self._folder = EgoFolder(run / self._name, header, self._folders)
        self._mcap = McapFile(run / f"{self._name}.mcap", header, self._folders, obstacles) if mcap else None

    def __enter__(self) -> EgoWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with ExitStack() as closing:
            closing.callback(self._folder.close)
            if self._mcap is not None:
                closing.callback(self._mcap.close if kind is None else self._mcap.abandon)

    def write(self, frame: EgoFrame) -> None:
        """Write one frame; numbers must rise. `RecordingError` for a sensor that was not announced."""
        if self._numbers and frame.number <= self._numbers[-1]:
            raise RecordingError(f"{self._name}: frame {frame.number} came after frame {self._numbers[-1]}")
        for reading in frame.readings:
            if reading.sensor not in self._folders:
                raise RecordingError(f"{reading.sensor.type} {reading.sensor.role!r} is not among the sensors")
        pictures = {r.sensor: png_bytes(r.pixels) for r in frame.readings if isinstance(r, ImageReading)}
        self._folder.write(frame, pictures)
        if self._mcap is not None:
            self._mcap.write(frame, pictures)
        self._numbers.append(frame.number)

    @property
    def summary(self) -> EgoSummary:
        """What has been written so far."""
        numbers = self._numbers
        return EgoSummary(self._name, len(numbers), numbers[0] if numbers else None, numbers[-1] if numbers else None)


class RecordingWriter:
    """A run folder: `ego0`, `ego1`, ... in CARLA's layout, an MCAP file each, `obstacles.json` and `recording.json`.

    `recording.json` is written last, when the block ends without an error: a folder without it was not finished.
    `RecordingError` if the folder holds anything already.
    """

    def __init__(
        self,
        folder: Path,
        header: RecordingHeader,
        egos: int,
        obstacles: Sequence[ObstacleTruth] = (),
        *,
        mcap: bool = True,
    ) -> None:
        begin_recording(folder, header, obstacles)
        self._folder, self._header = folder, header
        self._egos = [EgoWriter(folder, ego, header, obstacles, mcap=mcap) for ego in range(egos)]

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with ExitStack() as closing:
            for ego in self._egos:
                closing.callback(ego.__exit__, kind, error, trace)
        if kind is None:
            end_recording(self._folder, self._header, [ego.summary for ego in self._egos])

    def write(self, ego: int, frame: EgoFrame) -> None:
        """Write one frame of one vehicle; numbers must rise. `RecordingError` for a sensor that was not announced."""
        self._egos[ego].write(frame)


def begin_recording(folder: Path, header: RecordingHeader, obstacles: Sequence[ObstacleTruth]) -> None:
    """Make an empty run folder with its obstacles. `RecordingError` if it holds anything, or sensors share a name."""
    refuse_full(folder)
    sensor_folders(header.sensors)
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(folder / "obstacles.json", json_bytes([_obstacle_json(row) for row in obstacles]))


def refuse_full(folder: Path) -> None:
    """`RecordingError` unless a recording may begin there."""
    if folder.exists() and not folder.is_dir():
        raise RecordingError(f"{folder}: is a file; give a new or an empty folder")
    if folder.exists() and any(folder.iterdir()):
        raise RecordingError(f"{folder}: holds files already; give a new or an empty folder")


def end_recording(folder: Path, header: RecordingHeader, egos: Sequence[EgoSummary]) -> None:
    """Write `recording.json`, which says that everything before it is whole."""
    rows = [{key: value for key, value in asdict(ego).items() if value is not None} for ego in egos]
    write_whole(folder / "recording.json", json_bytes({**header.as_json(), "egos": rows}))


def _obstacle_json(row: ObstacleTruth) -> dict[str, object]:
    values = asdict(row) | {"kind": row.kind.value, "enu_m": list(row.enu_m)}
    return values | {"position": row.position.model_dump()}
