"""The film of a drive: rendered, painted and encoded in a process of its own while the other cars drive."""

from __future__ import annotations

import multiprocessing
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from multiprocessing.queues import Queue
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from headsup.demo.problem import DemoError
from simulator.scene.mover import Mover
from simulator.sensors.camera import CameraModel
from simulator.streets.street import Street
from simulator.world import World
from vehicle_client.ar.renderer import draw
from vehicle_client.ar.scene import Scene

if TYPE_CHECKING:
    from headsup.demo.printing import Reporter

CAMERA = CameraModel(width_px=640, height_px=360)
FRAMES_PER_S = 10.0
POLL_S = 0.2
MAX_WAITING = 8

Shot = tuple[NDArray[np.float64], float, Scene]
"""Where the car is, `street_from_vehicle` (4, 4), the world's time, and what its driver is shown."""


class Film:
    """VP9 in MP4, 640 x 360 at 10 pictures a second. Shots are queued; `finish` waits until all are on disk."""

    def __init__(self, path: Path, street: Street, movers: tuple[Mover, ...]) -> None:
        context = multiprocessing.get_context("spawn")
        self._shots: Queue[Shot | None] = context.Queue()
        self._done = context.Value("i", 0)
        self._process = context.Process(target=_make, args=(path, street, movers, self._shots, self._done), daemon=True)
        self._path = path
        self._count = 0

    def __enter__(self) -> Film:
        self._process.start()
        return self

    def add(self, street_from_vehicle: NDArray[np.float64], time_s: float, scene: Scene) -> None:
        """Append a shot."""
        self._shots.put((street_from_vehicle, time_s, scene))
        self._count += 1

    def finish(self, reporter: Reporter) -> None:
        """Wait for the file. Raises DemoError if it could not be made."""
        self._shots.put(None)
        while self._process.is_alive():
            self._process.join(POLL_S)
            reporter.progress("film", self._done.value, self._count)
        if self._process.exitcode != 0:
            raise DemoError(f"{self._path} could not be made; run with --no-video")

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        # When a drive failed, the shots that still wait do not matter any more.
        self._shots.cancel_join_thread()
        self._process.terminate()
        self._process.join()


def _make(
    path: Path,
    street: Street,
    movers: tuple[Mover, ...],
    shots: Queue[Shot | None],
    done: Synchronized[int],
) -> None:
    world = World(street, movers)
    code = cv2.VideoWriter.fourcc(*"vp09")
    writer = cv2.VideoWriter(str(path), code, FRAMES_PER_S, (CAMERA.width_px, CAMERA.height_px))
    if not writer.isOpened():
        raise SystemExit(1)
    # Encoding takes as long as rendering, and leaves Python alone: one beside the other they fill both cores.
    with ThreadPoolExecutor(max_workers=1) as encoder:
        waiting: deque[Future[None]] = deque()
        while (shot := shots.get()) is not None:
            street_from_vehicle, time_s, scene = shot
            picture = draw(scene, world.render(CAMERA, street_from_vehicle, 2, time_s))
            waiting.append(encoder.submit(_write, writer, picture))
            if len(waiting) > MAX_WAITING:
                waiting.popleft().result()
            done.value += 1
    writer.release()


def _write(writer: cv2.VideoWriter, picture: NDArray[np.uint8]) -> None:
    writer.write(picture)
