"""A whole drive: frames at their pace through the vehicle, and everybody told who wants to see what each brought."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from detector.errors import DetectorError
from detector.pipeline import detect
from detector.types import FrameDetection
from vehicle_client.ar.renderer import draw
from vehicle_client.drive import Step, Vehicle, detector_input, driver_scene
from vehicle_client.faults import Faults
from vehicle_client.pacing import Paced, Ready
from vehicle_client.positioning.matching_process import MatchingProcess
from vehicle_client.sensing.calibration import CameraCalibration
from vehicle_client.sensing.calibration_file import CarCalibration
from vehicle_client.sensing.preparation import Preparation
from vehicle_client.sources.frame import LidarFrame, SourceError
from vehicle_client.totals import Totals

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Known:
    """What preparing a frame told besides.

    `camera` is the camera where it was when it took the frame's picture, None without one; `detection` is what the
    sweep alone shows, None if it cannot be a sweep.
    """

    camera: CameraCalibration | None
    detection: FrameDetection | None


Listener = Callable[[Step, Ready[Known]], None]
"""Somebody who is told of each step, in the drive's thread: what takes its time belongs beside it (`beside`)."""


class Preparing:
    """What `Paced` does with each frame of a drive: `Preparation`, and detecting in the sweep meanwhile.

    Sweeps are matched in a process of its own, which ends with the block; at the sensor's pace (`realtime`) nobody
    waits until it is ready, else the same sweeps come out the same each time.
    """

    def __init__(self, car: CarCalibration, *, realtime: bool) -> None:
        self._car = car
        self._preparation = Preparation(car, partial(MatchingProcess, waits=not realtime))

    def __enter__(self) -> Preparing:
        return self

    def __exit__(self, *_: object) -> None:
        self._preparation.close()

    def __call__(self, frame: LidarFrame) -> tuple[LidarFrame, Known]:
        """The prepared frame, and what is known of it."""
        begun = self._preparation.begin(frame)
        if begun.point_time_s is None:
            # Where the points are does not depend on the motion, which is found out meanwhile.
            detection = self._detection(begun)
            prepared = self._preparation.finish(begun)
        else:
            prepared = self._preparation.finish(begun)
            detection = self._detection(prepared)
        camera = self._car.camera
        at_image = None if camera is None else self._preparation.camera_at_image(prepared, camera)
        return prepared, Known(at_image, detection)

    def _detection(self, frame: LidarFrame) -> FrameDetection | None:
        try:
            return detect(detector_input(frame, self._car.vehicle))
        except DetectorError:
            # The drive hears it again when it takes the frame, and counts it.
            return None


def drive_along(
    paced: Paced[Known],
    vehicle: Vehicle,
    totals: Totals,
    listeners: Sequence[Listener],
    displays: Sequence[Listener] = (),
) -> Step | None:
    """Drive until the source ends; the last step, with what the end of the drive brought, None without a usable frame.

    `displays` are told of each frame as soon as the driver's alerts are known, `listeners` when it is measured and
    reported, too. A frame that cannot be a sweep is skipped, said once, and counted; so is one in which the program
    fails, until too many fail in a row (`vehicle_client.faults`). A source that fails ends the drive as its end would,
    and `totals.broken_off` says why.
    """
    last: Step | None = None
    faults = Faults()
    frames = iter(paced)
    while (ready := _next(frames, totals)) is not None:
        try:
            last = _seen(ready, vehicle, totals)
            _show(last, ready, displays)
            last = vehicle.tell(last)
            totals.add(last)
            _show(last, ready, listeners)
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


def _show(step: Step, ready: Ready[Known], whom: Sequence[Listener]) -> None:
    for listen in whom:
        listen(step, ready)


def _next(frames: Iterator[Ready[Known]], totals: Totals) -> Ready[Known] | None:
    try:
        return next(frames, None)
    except (SourceError, OSError) as error:
        totals.broken_off = str(error)
        return None


def _seen(ready: Ready[Known], vehicle: Vehicle, totals: Totals) -> Step:
    seen = vehicle.see(ready.frame, ready.known.detection)
    totals.latency.observe(time.monotonic() - ready.complete_s)
    return seen


def _finished(last: Step, vehicle: Vehicle, totals: Totals) -> Step:
    end = vehicle.finish(last)
    totals.add_told(end)
    return end


def windshield(step: Step, ready: Ready[Known], car: CarCalibration) -> NDArray[np.uint8] | None:
    """What the driver is shown on the frame's picture, (H, W, 3) uint8 BGR; None without a picture or a camera."""
    if ready.known.camera is None or ready.frame.image is None:
        return None
    note = "" if step.reason is None else step.reason
    return draw(driver_scene(step, car.vehicle, ready.known.camera, note), ready.frame.image)
