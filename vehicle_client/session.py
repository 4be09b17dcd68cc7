"""A whole drive: frames at their pace through the vehicle, and everybody told who wants to see what each brought."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from detector.types import DetectorError
from vehicle_client.ar.renderer import draw
from vehicle_client.drive import Step, Vehicle, driver_scene
from vehicle_client.faults import Faults
from vehicle_client.pacing import Paced, Ready
from vehicle_client.sensing.calibration import CameraCalibration
from vehicle_client.sensing.calibration_file import CarCalibration
from vehicle_client.sensing.preparation import Preparation
from vehicle_client.sources.frame import LidarFrame, SourceError
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

    A frame that cannot be a sweep is skipped, said once, and counted; so is one in which the program fails, until too
    many fail in a row (`vehicle_client.faults`). A source that fails ends the drive as its end would, and
    `totals.broken_off` says why.
    """
    last: Step | None = None
    faults = Faults()
    frames = iter(paced)
    while (ready := _next(frames, totals)) is not None:
        try:
            last = _taken_in(ready, vehicle, totals)
            for listen in listeners:
                listen(last, ready)
        except DetectorError as error:
            totals.unusable += 1
            _LOG.log(logging.WARNING if totals.unusable == 1 else logging.DEBUG, "a frame is skipped: %s", error)
        except Exception as error:  # a fault in one frame ends no drive; too many in a row are raised
            faults.add(error)
        else:
            faults.end_row()
    try:
        return None if last is None else _finished(last, vehicle, totals)
    except Exception as error:  # what the drive came to is told all the same
        faults.add(error)
        return last
    finally:
        totals.faults = faults.total + paced.faults.total


def _next(frames: Iterator[Ready[Camera]], totals: Totals) -> Ready[Camera] | None:
    try:
        return next(frames, None)
    except (SourceError, OSError) as error:
        totals.broken_off = str(error)
        return None


def _taken_in(ready: Ready[Camera], vehicle: Vehicle, totals: Totals) -> Step:
    step = vehicle.step(ready.frame)
    totals.latency.observe(time.monotonic() - ready.complete_s)
    totals.add(step)
    return step


def _finished(last: Step, vehicle: Vehicle, totals: Totals) -> Step:
    end = vehicle.finish(last)
    totals.add_told(end)
    return end


def windshield(step: Step, ready: Ready[Camera], car: CarCalibration) -> NDArray[np.uint8] | None:
    """What the driver is shown on the frame's picture, (H, W, 3) uint8 BGR; None without a picture or a camera."""
    if ready.known is None or ready.frame.image is None:
        return None
    note = "" if step.reason is None else step.reason
    return draw(driver_scene(step, car.vehicle, ready.known, note), ready.frame.image)
