"""A whole drive: frames at their pace through the vehicle, and everybody told who wants to see what each brought."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from detector.types import DetectorError
from vehicle_client.ar.renderer import draw
from vehicle_client.calibration import CameraCalibration
from vehicle_client.calibration_file import CarCalibration
from vehicle_client.drive import Step, Vehicle, driver_scene
from vehicle_client.pacing import Paced, Ready
from vehicle_client.preparation import Preparation
from vehicle_client.sources.frame import LidarFrame
from vehicle_client.totals import Totals

_LOG = logging.getLogger(__name__)

Camera = CameraCalibration | None
"""The camera where it was when it took a frame's picture; None without one."""

Listener = Callable[[Step, Ready[Camera]], None]
"""Somebody who is told of each step, in the drive's thread."""


def preparing(car: CarCalibration) -> Callable[[LidarFrame], tuple[LidarFrame, Camera]]:
    """What `Paced` does with each frame: stamps of one clock, odometry, points of one moment, the camera's place."""
    preparation = Preparation(car)

    def prepare(frame: LidarFrame) -> tuple[LidarFrame, Camera]:
        prepared = preparation.prepared(frame)
        camera = None if car.camera is None else preparation.camera_at_image(prepared, car.camera)
        return prepared, camera

    return prepare


def drive_along(paced: Paced[Camera], vehicle: Vehicle, totals: Totals, listeners: Sequence[Listener]) -> Step | None:
    """Drive until the source ends; the last step, with what the end of the drive brought, None without a usable frame.

    A frame that cannot be a sweep is skipped, said once, and counted.
    """
    last: Step | None = None
    for ready in paced:
        try:
            last = vehicle.step(ready.frame)
        except DetectorError as error:
            totals.unusable += 1
            _LOG.log(logging.WARNING if totals.unusable == 1 else logging.DEBUG, "a frame is skipped: %s", error)
            continue
        totals.latency.observe(time.monotonic() - ready.complete_s)
        totals.add(last)
        for listen in listeners:
            listen(last, ready)
    if last is None:
        return None
    end = vehicle.finish(last)
    totals.add_told(end)
    return end


def windshield(step: Step, ready: Ready[Camera], car: CarCalibration) -> NDArray[np.uint8] | None:
    """What the driver is shown on the frame's picture, (H, W, 3) uint8 BGR; None without a picture or a camera."""
    if ready.known is None or ready.frame.image is None:
        return None
    note = "" if step.reason is None else step.reason
    return draw(driver_scene(step, car.vehicle, ready.known, note), ready.frame.image)
