"""Moments of a drive that are worth a look, and what the vehicles saw in them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.changes import Worlds
from simulator.drive import frame_numbers
from simulator.readings import EgoFrame, ImageReading, LidarReading, Sweep
from simulator.scenario import Scenario
from simulator.sensors.camera import CameraModel
from simulator.sensors.sensor_config import SensorRig
from simulator.streets.street import PlacedObstacle

FloatArray = NDArray[np.float64]

LOOK_AHEAD_M = 9.0
"""Near enough that a pothole of half a metre is some fifty pixels wide in a picture of 1000, and not below its edge."""

BESIDE_M = 4.5
"""Of the vehicle's line: its own lane and the next."""

PICTURES = 4
RGB_CAMERA = "sensor.camera.rgb"
ONLOOKER = CameraModel(width_px=640, height_px=320, horizontal_fov_rad=math.radians(70.0))
"""Looks where a rig has no camera of its own."""

RAYS_A_SIDE = 2


@dataclass(frozen=True, slots=True)
class Moment:
    """A frame of one ego, and the obstacle ahead of it; 0 where there is none."""

    ego: int
    frame: int
    obstacle_id: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """What one ego saw: a picture (H, W, 3) BGR of a camera at a (4, 4) pose, and a sweep where it has a LiDAR."""

    moment: Moment
    time_s: float
    pixels: NDArray[np.uint8]
    camera: CameraModel
    street_from_camera: FloatArray
    sweep: Sweep | None
    vehicle_from_sensor: FloatArray


def moments(happening: Scenario, tick_s: float) -> list[Moment]:
    """Up to four, in the order of egos and time: what changes, before and after it; then the largest obstacles.

    Where no obstacle is passed, the middle of each ego's drive.
    """
    numbers = [frame_numbers(ego, happening.plan.seconds, tick_s) for ego in happening.egos]
    changed = {change.obstacle_id for change in happening.changing.changes}
    chosen: list[Moment] = []
    for placed in sorted(happening.changing.street.obstacles, key=lambda o: (o.obstacle_id not in changed, -_size(o))):
        met = [_met(happening, ego, frames, tick_s, placed) for ego, frames in enumerate(numbers)]
        passes = [moment for moment in met if moment is not None]
        first_and_last = [passes[0], passes[-1]] if placed.obstacle_id in changed and len(passes) > 1 else passes[:1]
        chosen += first_and_last[: PICTURES - len(chosen)]
    if not chosen:
        chosen = [Moment(ego, frames[len(frames) // 2]) for ego, frames in enumerate(numbers[:PICTURES]) if frames]
    return sorted(chosen, key=lambda moment: (moment.ego, moment.frame))


def _met(happening: Scenario, ego: int, frames: range, tick_s: float, placed: PlacedObstacle) -> Moment | None:
    """The first frame in which the obstacle lies close ahead."""
    if not frames:
        return None
    poses = happening.egos[ego].trajectory.poses(np.array(frames) * tick_s)
    offset = np.array([placed.x_m, placed.y_m]) - poses[:, :2, 3]
    ahead = np.einsum("ni,ni->n", offset, poses[:, :2, 0])
    left = np.einsum("ni,ni->n", offset, poses[:, :2, 1])
    near = np.flatnonzero((ahead <= LOOK_AHEAD_M) & (ahead > LOOK_AHEAD_M / 2) & (np.abs(left) < BESIDE_M))
    return Moment(ego, frames[near[0]], placed.obstacle_id) if near.size else None


def _size(placed: PlacedObstacle) -> float:
    return placed.shape.footprint_area_m2 * placed.shape.relief_m


class Onlooker:
    """Keeps the pictures and sweeps of one ego's moments while its frames pass by."""

    def __init__(self, chosen: Sequence[Moment], rig: SensorRig, worlds: Worlds, mover: int) -> None:
        self._waiting = deque(chosen)
        self._worlds, self._mover = worlds, mover
        models = {sensor.name: sensor.model for sensor in rig.sensors if sensor.name.type == RGB_CAMERA}
        self._cameras = {name: model for name, model in models.items() if isinstance(model, CameraModel)}
        self.sights: list[Sight] = []

    def look(self, frame: EgoFrame) -> None:
        """Keep what belongs to a moment: the first picture from its frame on, or one that is made."""
        while self._waiting and self._waiting[0].frame <= frame.number:
            seen = self._picture(frame)
            if seen is None:
                return
            camera, pixels = seen
            street_from_camera = frame.street_from_vehicle @ camera.vehicle_from_camera
            self.sights.append(
                Sight(self._waiting.popleft(), frame.time_s, pixels, camera, street_from_camera, *_turn(frame))
            )

    def _picture(self, frame: EgoFrame) -> tuple[CameraModel, NDArray[np.uint8]] | None:
        """None where the vehicle has a camera that did not look at this frame."""
        for reading in frame.readings:
            if isinstance(reading, ImageReading) and reading.sensor in self._cameras:
                return self._cameras[reading.sensor], reading.pixels
        if self._cameras:
            return None
        world = self._worlds.at(frame.time_s)
        pixels = world.render(ONLOOKER, frame.street_from_vehicle, RAYS_A_SIDE, frame.time_s, self._mover)
        return ONLOOKER, pixels


def _turn(frame: EgoFrame) -> tuple[Sweep | None, FloatArray]:
    """The first LiDAR's turn that ends at the frame, and `vehicle_from_sensor`."""
    for reading in frame.readings:
        if isinstance(reading, LidarReading):
            return reading.sweep, np.linalg.inv(frame.street_from_vehicle) @ reading.street_from_sensor
    return None, np.eye(4)
