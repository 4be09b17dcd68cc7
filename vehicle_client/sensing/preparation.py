"""What a frame needs before anything looks at it: stamps of one clock, odometry, and points of one moment."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from vehicle_client.frames import Matrix, inverse
from vehicle_client.positioning.odometry import ScanMatching, Tracker, tracker_for
from vehicle_client.sensing.calibration import CameraCalibration
from vehicle_client.sensing.calibration_file import CarCalibration
from vehicle_client.sensing.deskew import Twist, deskew, twist_between
from vehicle_client.sensing.time_alignment import aligned
from vehicle_client.sources.frame import LidarFrame


class Preparation:
    """Takes the frames of a drive one after the other; a frame that it gave is in order for `pose` and detector.

    `matching` makes what follows the sweeps of a drive that brings no odometry.
    """

    def __init__(self, calibration: CarCalibration, matching: Callable[[Matrix], Tracker] = ScanMatching) -> None:
        self._calibration, self._matching = calibration, matching
        self._tracker: Tracker | None = None
        self._before: tuple[float, Matrix] | None = None
        self._twist: Twist | None = None

    def prepared(self, frame: LidarFrame) -> LidarFrame:
        """The frame with aligned stamps, `odom_from_vehicle` if anything tells it, and points at the frame's stamp.

        Points stay as they came where their times are not known (and the calibration's spin does not tell them), and in
        the first frame, whose motion nobody knows. A frame without a time has no odometry.
        """
        return self.finish(self.begin(frame))

    def begin(self, frame: LidarFrame) -> LidarFrame:
        """The first half of `prepared`: stamps and times of points; where the car is may be found out meanwhile.

        If the frame that comes out has no times, its points are those that `finish` will give.
        """
        if not math.isfinite(frame.stamp_s):
            return replace(frame, odom_from_vehicle=None, point_time_s=None)
        frame = self._with_times(aligned(frame, self._calibration.delays))
        if self._tracker is None:
            vehicle_from_sensor = self._calibration.vehicle.vehicle_from_sensor
            self._tracker = tracker_for(frame, vehicle_from_sensor, self._calibration.wheelbase_m, self._matching)
        self._tracker.begin(frame)
        return frame

    def finish(self, begun: LidarFrame) -> LidarFrame:
        """The second half of `prepared`, for the frame that `begin` gave last."""
        if self._tracker is None or not math.isfinite(begun.stamp_s):
            return begun
        odom_from_vehicle = self._tracker.odom_from_vehicle(begun)
        self._twist = self._twist_until(begun.stamp_s, odom_from_vehicle)
        return self._deskewed(replace(begun, odom_from_vehicle=odom_from_vehicle))

    def close(self) -> None:
        """No frame comes any more."""
        if self._tracker is not None:
            self._tracker.close()

    def camera_at_image(self, frame: LidarFrame, camera: CameraCalibration) -> CameraCalibration:
        """The camera where it was when it took the frame's picture, in the car's frame at the sweep's stamp."""
        if frame.image_stamp_s is None or self._twist is None:
            return camera
        moved = self._twist.now_from_then(frame.image_stamp_s - frame.stamp_s)
        return replace(camera, vehicle_from_camera=moved @ camera.vehicle_from_camera)

    def _with_times(self, frame: LidarFrame) -> LidarFrame:
        spin, said = self._calibration.spin, frame.point_time_s
        if said is not None and said.shape != (len(frame.points_m),):
            return replace(frame, point_time_s=None)
        if spin is None or said is not None:
            return frame
        return replace(frame, point_time_s=spin.point_time_s(frame.points_m))

    def _twist_until(self, stamp_s: float, odom_from_vehicle: Matrix | None) -> Twist | None:
        """The car's motion over the time since the frame before."""
        before = self._before
        known = odom_from_vehicle is not None and bool(np.isfinite(odom_from_vehicle).all())
        self._before = (stamp_s, odom_from_vehicle) if odom_from_vehicle is not None and known else None
        if before is None or odom_from_vehicle is None or not known:
            return None
        return twist_between(inverse(before[1]) @ odom_from_vehicle, stamp_s - before[0])

    def _deskewed(self, frame: LidarFrame) -> LidarFrame:
        if frame.point_time_s is None or self._twist is None:
            return frame
        points_m = deskew(frame.points_m, frame.point_time_s, self._sensor_twist(self._twist))
        return replace(frame, points_m=points_m, point_time_s=None)

    def _sensor_twist(self, twist: Twist) -> Twist:
        """The motion of the LiDAR on a car that moves by `twist`: in its own axes, with the lever's own velocity."""
        vehicle_from_sensor = self._calibration.vehicle.vehicle_from_sensor
        sensor_from_vehicle = vehicle_from_sensor[:3, :3].T
        velocity = twist.velocity_mps + np.cross(twist.angular_rps, vehicle_from_sensor[:3, 3])
        return Twist(sensor_from_vehicle @ velocity, sensor_from_vehicle @ twist.angular_rps)
