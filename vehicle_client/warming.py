"""A drive along a street that nobody made: what is compiled is loaded, or compiled, before a sensor waits for it."""

from __future__ import annotations

import numpy as np

from detector.arrays import FloatArray
from detector.passes.accumulator import Accumulator, accumulate, hits_around
from detector.passes.inspection import KnownPlace, inspect
from detector.passes.shape import measure
from detector.pipeline import detect
from vehicle_client.drive import Vehicle, detector_input
from vehicle_client.frames import rigid
from vehicle_client.link.nobody import NobodyLink
from vehicle_client.sensing.calibration import VehicleCalibration
from vehicle_client.sensing.deskew import Twist, deskew
from vehicle_client.sources.frame import LidarFrame

SENSOR_HEIGHT_M = 2.0
STEP_M = 0.6
SWEEPS = 14
"""Enough to believe in what lies on the street, and to come by it."""

RELIEF_M = {(9.0, 0.6): -0.12, (9.0, -1.2): 0.25}
"""Depth of a hole and height of a thing, by where they lie from where the drive begins."""
RADIUS_M = 0.4
RINGS, COLUMNS = np.deg2rad(np.linspace(-30.0, -4.0, 40)), np.deg2rad(np.arange(-90.0, 90.0, 0.25))


def load_compiled() -> None:
    """Do once all that a drive does in compiled loops: seconds, and minutes where nothing was ever compiled."""
    vehicle_from_sensor = rigid(np.eye(3), np.array([0.0, 0.0, SENSOR_HEIGHT_M]))
    calibration = VehicleCalibration(vehicle_from_sensor, "nobody's")
    vehicle, passed = Vehicle(calibration, NobodyLink(), pseudonym="nobody"), Accumulator()
    for index in range(SWEEPS):
        frame = _sweep(index)
        sweep = detector_input(frame, calibration)
        detection = detect(sweep)
        vehicle.step(frame, detection)
        passed = accumulate(passed, sweep, detection)
    for (x_m, y_m), relief_m in RELIEF_M.items():
        side_m, is_negative = 2 * RADIUS_M, relief_m < 0
        centre_m = np.array([x_m, y_m, 0.0])
        measure(hits_around(passed, centre_m[:2]), is_negative)
        place = KnownPlace(centre_m, side_m, side_m, 0.0, abs(relief_m), is_negative, place_sd_m=0.3)
        inspect(hits_around(passed, centre_m[:2], place.half_size_m), place)
    deskew(frame.points_m, np.zeros(len(frame.points_m), dtype=np.float32), Twist(np.zeros(3), np.zeros(3)))


def _sweep(index: int) -> LidarFrame:
    """What a LiDAR sees of a flat street with a hole and a thing, after so many steps."""
    moved_m = np.array([STEP_M * index, 0.0, 0.0])
    elevation, azimuth = (angles.ravel() for angles in np.meshgrid(RINGS, COLUMNS))
    range_m = SENSOR_HEIGHT_M / -np.tan(elevation)
    x_m, y_m = range_m * np.cos(azimuth), range_m * np.sin(azimuth)
    points_m = np.column_stack([x_m, y_m, _relief_m(x_m + moved_m[0], y_m) - SENSOR_HEIGHT_M])
    return LidarFrame(0.1 * index, points_m.astype(np.float32), odom_from_vehicle=rigid(np.eye(3), moved_m))


def _relief_m(x_m: FloatArray, y_m: FloatArray) -> FloatArray:
    height_m = np.zeros(len(x_m))
    for (there_x_m, there_y_m), relief_m in RELIEF_M.items():
        height_m[np.hypot(x_m - there_x_m, y_m - there_y_m) < RADIUS_M] = relief_m
    return height_m
