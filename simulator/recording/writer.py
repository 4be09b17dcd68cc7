"""Recordings of several vehicles, written frame by frame.

with RecordingWriter(folder, header, egos=2, obstacles=truth) as recording:
    for frame in frames:
        recording.write(ego, frame)
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from types import TracebackType

from simulator.readings import EgoFrame, ImageReading, ObstacleTruth
from simulator.recording.carla_layout import EgoFolder
from simulator.recording.files import RecordingError, json_bytes, png_bytes, write_whole
from simulator.recording.header import RecordingHeader, sensor_folders
from simulator.recording.mcap_file import McapFile


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
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise RecordingError(f"{folder}: holds files already; give a new or an empty folder")
        self._folder = folder
        self._header = header
        self._folders = sensor_folders(header.sensors)
        self._frames: list[list[int]] = [[] for _ in range(egos)]
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(folder / "obstacles.json", json_bytes([_obstacle_json(row) for row in obstacles]))
        self._egos = [EgoFolder(folder / f"ego{ego}", header, self._folders) for ego in range(egos)]
        self._mcaps = [
            McapFile(folder / f"ego{ego}.mcap", header, self._folders, obstacles) for ego in range(egos) if mcap
        ]

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with ExitStack() as closing:
            for ego in self._egos:
                closing.callback(ego.close)
            for mcap in self._mcaps:
                closing.callback(mcap.close if kind is None else mcap.abandon)
        if kind is None:
            write_whole(self._folder / "recording.json", json_bytes(self._summary()))

    def write(self, ego: int, frame: EgoFrame) -> None:
        """Write one frame of one vehicle; numbers must rise. `RecordingError` for a sensor that was not announced."""
        known = self._frames[ego]
        if known and frame.number <= known[-1]:
            raise RecordingError(f"ego{ego}: frame {frame.number} came after frame {known[-1]}")
        for reading in frame.readings:
            if reading.sensor not in self._folders:
                raise RecordingError(f"{reading.sensor.type} {reading.sensor.role!r} is not among the sensors")
        pictures = {r.sensor: png_bytes(r.pixels) for r in frame.readings if isinstance(r, ImageReading)}
        self._egos[ego].write(frame, pictures)
        if self._mcaps:
            self._mcaps[ego].write(frame, pictures)
        known.append(frame.number)

    def _summary(self) -> dict[str, object]:
        egos = [
            {"folder": f"ego{ego}", "frames": len(numbers), "first": min(numbers), "last": max(numbers)}
            if numbers
            else {"folder": f"ego{ego}", "frames": 0}
            for ego, numbers in enumerate(self._frames)
        ]
        return {**self._header.as_json(), "egos": egos}


def _obstacle_json(row: ObstacleTruth) -> dict[str, object]:
    values = asdict(row) | {"kind": row.kind.value, "enu_m": list(row.enu_m)}
    return values | {"position": row.position.model_dump()}
