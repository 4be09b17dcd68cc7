"""The demo's stills: taken at the moments that matter, rendered large."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from detector.pipeline import detect
from headsup.demo.problem import DemoError
from headsup.demo.simulated import camera_calibration
from simulator.readings import EgoFrame
from simulator.sensors.camera import CameraModel
from simulator.world import World
from vehicle_client.alerts import Hazard, Stage
from vehicle_client.ar.renderer import draw
from vehicle_client.ar.segmentation import paint_classes, paint_saliency
from vehicle_client.drive import Step, detector_input, driver_scene
from vehicle_client.frames import apply
from vehicle_client.sensing.calibration import CameraCalibration, VehicleCalibration

Image = NDArray[np.uint8]

STILL = CameraModel(width_px=1280, height_px=720)
SUPERSAMPLE = 2


@dataclass(frozen=True, slots=True)
class Moment:
    """A still to take once: of which car, when, its file name and what the report says below it."""

    car: str
    when: Callable[[Step], bool]
    name: str
    caption: str


def _nearest(step: Step) -> Hazard | None:
    return step.alerts.hazards[0] if step.alerts.hazards else None


def _recognised_near(step: Step) -> bool:
    hazard = _nearest(step)
    return hazard is not None and hazard.recognised and 6.5 < hazard.distance_m < 10.0


def _early(step: Step) -> bool:
    hazard = _nearest(step)
    return hazard is not None and hazard.stage is Stage.ADVISE and not hazard.recognised


def _marked(step: Step) -> bool:
    hazard = _nearest(step)
    return hazard is not None and hazard.stage is Stage.WARN and not hazard.recognised and hazard.distance_m < 45.0


MOMENTS = (
    Moment("ego1", _recognised_near, "ego1-recognition", "ego1's own LiDAR recognises a hole that nobody knew."),
    Moment(
        "ego2",
        _early,
        "ego2-early-warning",
        "ego2 is told by the server: the hole is far beyond what its LiDAR or its driver can see.",
    ),
    Moment(
        "ego2",
        _marked,
        "ego2-marker",
        "Nearer, beacons mark the places, as well as two cars' satellites know them: to a metre or two.",
    ),
    Moment(
        "ego2",
        _recognised_near,
        "ego2-recognition",
        "ego2's own LiDAR confirms it: the ring turns red, and the beacons move with it to where they belong.",
    ),
)

SEGMENTED = (
    "segmentation",
    "Classes of all points of ego2's sweep, gaps filled: safe blue, below the road yellow, "
    "above it cyan, off the road purple, recognised obstacle red.",
)
SALIENCY = (
    "saliency",
    "The paper's saliency of the same sweep as a heat map: over a whole street walls, poles and trees outshine a hole.",
)


class Album:
    """Takes each still once, at its moment, and keeps it in a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.stills: dict[str, str] = {}
        """Caption by file name, in the order taken."""

    def consider(self, car: str, step: Step, calibration: VehicleCalibration, world: World, moment: EgoFrame) -> None:
        """Take the stills whose moment this is."""
        due = [m for m in MOMENTS if m.car == car and f"{m.name}.png" not in self.stills and m.when(step)]
        if not due:
            return
        image = world.render(STILL, moment.street_from_vehicle, SUPERSAMPLE, moment.time_s)
        camera = camera_calibration(STILL)
        for still in due:
            self._keep(still.name, still.caption, draw(driver_scene(step, calibration, camera, still.car), image))
            if still.name == "ego2-recognition":
                self._keep_sensor_views(step, calibration, camera, image)

    def _keep_sensor_views(
        self, step: Step, calibration: VehicleCalibration, camera: CameraCalibration, image: Image
    ) -> None:
        points = apply(calibration.vehicle_from_sensor, step.frame.points_m)
        self._keep(*SEGMENTED, paint_classes(camera, points, step.detection.labels, image))
        saliency = detect(detector_input(step.frame, calibration), method="saliency").saliency
        self._keep(*SALIENCY, paint_saliency(camera, points, saliency, image))

    def _keep(self, name: str, caption: str, image: Image) -> None:
        path = self._folder / f"{name}.png"
        if not cv2.imwrite(str(path), image):
            raise DemoError(f"{path} cannot be written")
        self.stills[path.name] = caption
