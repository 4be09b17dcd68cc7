"""Whether one vehicle keeps up with its LiDAR: the whole loop at the sensor's pace, and how late the driver is told.

Read, prepare, detect, accumulate, track, measure, report into the outbox on disk, alert, compose and draw; in the
threads and processes of `headsup drive --realtime`. The sweep's age counts from the moment it was complete to the
alerts; sweeps before scan matching is ready are not among the ages.
Two drives: HDL-64E sweeps of 120,000 points at 10 Hz (`kitti_drive` of `--data`, whose poses come from scan matching;
written as KITTI's own files first, since LAZ takes 45 ms to unpack and no sensor sends it),
and sweeps of the paper's LiDAR, 26,600 points at 30 Hz, of a simulated recording that is made first. No server answers:
hearing and delivering wait in threads of their own. Each picture is drawn upon a grey image of 1024 x 512. The first
sweeps compile the detector and are not counted.

Examples:

    python -m benchmarks.vehicle --data data

    python -m benchmarks.vehicle --recording runs/0001 --seconds 10
"""

from __future__ import annotations

import argparse
import itertools
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import psutil

from vehicle_client.beside import Beside
from vehicle_client.drive import Step, Vehicle
from vehicle_client.frames import rigid
from vehicle_client.link.background import BackgroundLink
from vehicle_client.link.server_link import ServerLink
from vehicle_client.pacing import Paced, Ready
from vehicle_client.sensing.calibration import CameraCalibration, VehicleCalibration
from vehicle_client.sensing.calibration_file import AHEAD_FROM_CAMERA, CarCalibration
from vehicle_client.session import Known, Preparing, drive_along, windshield
from vehicle_client.sources.frame import LidarFrame
from vehicle_client.sources.opening import SourceOptions, open_source
from vehicle_client.totals import Totals

WARMING_FRAMES = 20
NOBODY = "http://127.0.0.1:9"
IMAGE = np.full((512, 1024, 3), 128, dtype=np.uint8)
KITTI_HEIGHT_M, PAPER_HEIGHT_M = 1.73, 2.4


@dataclass(frozen=True, slots=True)
class Run:
    """What one drive took."""

    name: str
    totals: Totals
    dropped: int
    points: float
    not_drawn: int
    ages_ms: list[float]
    cpu_ms: float
    """Processor time of all threads and processes for each frame."""
    draw_ms: float


def main() -> None:
    """Print a table in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="folder with kitti_drive/; without it only the simulated drive")
    parser.add_argument("--recording", type=Path, help="a recording in CARLA's layout instead of one made anew")
    parser.add_argument("--seconds", type=float, default=14.0, help="of each drive")
    options = parser.parse_args()
    runs = []
    if options.data is not None:
        with tempfile.TemporaryDirectory(prefix="headsup-bench-") as folder:
            unpacked = _unpacked(options.data / "kitti_drive", Path(folder) / "sweeps")
            runs.append(_run("HDL-64E, 10 Hz, poses by scan matching", unpacked, KITTI_HEIGHT_M, options))
    with tempfile.TemporaryDirectory(prefix="headsup-bench-") as folder:
        recording = options.recording or _recorded(Path(folder) / "drive", options.seconds)
        runs.append(_run("the paper's LiDAR, 30 Hz, recorded odometry", recording, PAPER_HEIGHT_M, options))
    print(
        "| drive | points | frames | dropped | not drawn | p50 ms | p95 ms | p99 ms | CPU ms a frame | of it drawing |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for run in runs:
        late = np.percentile(run.ages_ms or [np.nan], (50, 95, 99))
        numbers = [f"{run.points:,.0f}", run.totals.frames, run.dropped, run.not_drawn, *(f"{ms:.0f}" for ms in late)]
        print("|", " | ".join(map(str, [run.name, *numbers, f"{run.cpu_ms:.1f}", f"{run.draw_ms:.1f}"])), "|")


def _unpacked(source: Path, folder: Path) -> Path:
    folder.mkdir()
    for number, frame in enumerate(open_source(source)):
        intensity = np.zeros(len(frame.points_m)) if frame.intensity is None else frame.intensity
        np.column_stack([frame.points_m, intensity]).astype("<f4").tofile(folder / f"{number:06d}.bin")
    return folder


def _recorded(folder: Path, seconds: float) -> Path:
    command = (sys.executable, "-m", "headsup.cli", "simulate", "drive", "--egos", "1", "--no-images", "--seed", "3")
    subprocess.run((*command, "--seconds", str(seconds), "--out", str(folder)), check=True)  # noqa: S603  # ourselves
    return folder


def _run(name: str, source: Path, height_m: float, options: argparse.Namespace) -> Run:
    car = CarCalibration(VehicleCalibration(rigid(np.eye(3), np.array([0.0, 0.0, height_m])), "lidar"), _camera())
    frames = _within(open_source(source, SourceOptions(start_s=time.time())), options.seconds)
    warming = list(itertools.islice(open_source(source), WARMING_FRAMES))
    with tempfile.TemporaryDirectory(prefix="headsup-bench-") as folder:
        link = ServerLink(NOBODY, None, Path(folder) / "outbox.sqlite3")
        _drive(car, Vehicle(car.vehicle, link, pseudonym="warming"), warming, realtime=False)
        with BackgroundLink(link) as background:
            vehicle = Vehicle(car.vehicle, background, pseudonym="benchmark")
            return replace(_drive(car, vehicle, frames, realtime=True), name=name)


def _drive(car: CarCalibration, vehicle: Vehicle, frames: Iterable[LidarFrame], *, realtime: bool) -> Run:
    totals, points, drawing_s = Totals(), 0, 0.0
    ages_ms: list[float] = []

    def draw(shown: tuple[Step, Ready[Known]]) -> None:
        nonlocal drawing_s
        step, ready = shown
        begun_s = time.thread_time()
        windshield(step, replace(ready, frame=replace(ready.frame, image=IMAGE)), car)
        drawing_s += time.thread_time() - begun_s

    def show(step: Step, ready: Ready[Known]) -> None:
        nonlocal points
        if step.frame.odom_from_vehicle is not None:
            ages_ms.append(1000 * (time.monotonic() - ready.complete_s))
        points += len(step.frame.points_m)
        drawing.add((step, ready))

    before_s = _cpu_s()
    drawing = Beside(draw, name="drawing", most_waiting=1)
    with (
        Preparing(car, realtime=realtime) as preparing,
        Paced[Known](frames, preparing, realtime=realtime, is_recorded=True) as paced,
    ):
        drive_along(paced, vehicle, totals, (), displays=[show])
        cpu_s = _cpu_s() - before_s
    drawing.close()
    number = max(totals.frames, 1)
    each = points / number, drawing.dropped, ages_ms, 1000 * cpu_s / number, 1000 * drawing_s / number
    return Run("", totals, paced.dropped, *each)


def _cpu_s() -> float:
    """Of this process and those it has begun."""
    alone = psutil.Process()
    times = [process.cpu_times() for process in (alone, *alone.children(recursive=True))]
    return sum(t.user + t.system for t in times)


def _within(source: Iterable[LidarFrame], seconds: float) -> Iterator[LidarFrame]:
    first_s: float | None = None
    for frame in source:
        first_s = frame.stamp_s if first_s is None else first_s
        if frame.stamp_s - first_s > seconds:
            return
        yield frame


def _camera() -> CameraCalibration:
    """The paper's: 1024 x 512 pixels, 100 degrees."""
    focal_px = 512 / np.tan(np.radians(50))
    matrix = np.array([[focal_px, 0.0, 512.0], [0.0, focal_px, 256.0], [0.0, 0.0, 1.0]])
    return CameraCalibration(matrix, 1024, 512, rigid(AHEAD_FROM_CAMERA, np.array([0.0, 0.0, PAPER_HEIGHT_M])))


if __name__ == "__main__":
    main()
