"""Odometry for drives that bring none: from wheels and yaw rate, else from the sweeps themselves."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vehicle_client.frames import Matrix, inverse, rigid, rotation_about_z
from vehicle_client.positioning.matched_points import REACH_M, worth_matching
from vehicle_client.positioning.odometry_history import ODOMETRY_GAP_S
from vehicle_client.sensing.calibration import curvature_of
from vehicle_client.sensing.deskew import Twist, deskew, twist_between
from vehicle_client.sources.frame import LidarFrame, Motion

COASTS_S = 0.5
"""Cars send wheel speed at 10 to 100 Hz: after half a second of silence the line is cut, and there is no odometry."""

VOXEL_M = 1.0
"""The map that sweeps are matched to: KISS-ICP's own default, a hundredth of its range."""

LEAST_POINTS = 100
"""Fewer points hold no shape to match."""

CONVERGED = 2e-3
"""Metres and radians of a step after which no more are made. KISS-ICP's own 1e-4 takes nearly twice the time for the
same way; 3e-3 is as good at 50 km/h, but its steps are twice as uneven at 90."""

FORWARD_MPS = 5.0
"""Nobody reverses faster: from here on a speed without a sign is one ahead."""

UNEVEN = 0.1
"""Sweeps that are so much farther apart than those before, or nearer, as a share, are expected elsewhere."""


@dataclass(frozen=True, slots=True)
class DeadReckoning:
    """Where wheels and yaw rate have carried a car in the plane, by arcs of constant speed and rate."""

    stamp_s: float
    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0
    speed_mps: float = 0.0
    yaw_rate_rps: float = 0.0
    heard_s: float = -math.inf

    def after(self, motions: Sequence[Motion], stamp_s: float) -> DeadReckoning:
        """The car at `stamp_s`, Unix time; motions that are late, or beyond it, count from where the car is."""
        car = self
        for motion in motions:
            if motion.speed_mps is None or not _finite(motion):
                continue
            car = car._coasted(min(motion.stamp_s, stamp_s))
            rate = motion.yaw_rate_rps
            car = replace(
                car,
                speed_mps=motion.speed_mps,
                # A gyro's offset must not turn a parked car.
                yaw_rate_rps=0.0 if motion.speed_mps == 0 else car.yaw_rate_rps if rate is None else rate,
                heard_s=motion.stamp_s,
            )
        return car._coasted(stamp_s)

    def odom_from_vehicle(self) -> Matrix | None:
        """(4, 4), or None when nothing was heard for `COASTS_S`."""
        if self.stamp_s - self.heard_s > COASTS_S:
            return None
        return rigid(rotation_about_z(self.yaw_rad), np.array([self.x_m, self.y_m, 0.0]))

    def _coasted(self, stamp_s: float) -> DeadReckoning:
        """On the arc until a moment; a moment before the present (a clock was set back) only sets the time."""
        elapsed_s = min(stamp_s - self.stamp_s, ODOMETRY_GAP_S)
        if elapsed_s <= 0:
            return self if elapsed_s > -COASTS_S else replace(self, stamp_s=stamp_s)
        turn = self.yaw_rate_rps * elapsed_s
        chord_m = self.speed_mps * elapsed_s * float(np.sinc(turn / (2 * math.pi)))
        towards = self.yaw_rad + turn / 2
        return replace(
            self,
            stamp_s=stamp_s,
            x_m=self.x_m + chord_m * math.cos(towards),
            y_m=self.y_m + chord_m * math.sin(towards),
            yaw_rad=math.remainder(self.yaw_rad + turn, 2 * math.pi),
        )


def _finite(motion: Motion) -> bool:
    return all(
        value is None or math.isfinite(value) for value in (motion.stamp_s, motion.speed_mps, motion.yaw_rate_rps)
    )


class Tracker(ABC):
    """Something that follows the car from frame to frame."""

    def begin(self, frame: LidarFrame) -> None:  # noqa: B027  # most do all in `odom_from_vehicle`
        """Take the frame in, if that goes on while the caller does something else."""

    @abstractmethod
    def odom_from_vehicle(self, frame: LidarFrame) -> Matrix | None:
        """(4, 4) at the frame's stamp, None if it cannot be said."""

    def close(self) -> None:  # noqa: B027  # most hold nothing
        """Let go of what it holds; no frame comes any more."""


class Given(Tracker):
    """The source brings odometry."""

    def odom_from_vehicle(self, frame: LidarFrame) -> Matrix | None:
        """What the frame says."""
        return frame.odom_from_vehicle


class Wheels(Tracker):
    """Dead reckoning over the frames' motions; without a yaw rate the steering tells the turn."""

    def __init__(self, wheelbase_m: float) -> None:
        self._wheelbase_m = wheelbase_m
        self._car: DeadReckoning | None = None

    def odom_from_vehicle(self, frame: LidarFrame) -> Matrix | None:
        """Where wheels have carried the car until the frame's stamp."""
        if self._car is None:
            self._car = DeadReckoning(frame.stamp_s)
        self._car = self._car.after(self._motions(frame), frame.stamp_s)
        return self._car.odom_from_vehicle()

    def _motions(self, frame: LidarFrame) -> list[Motion]:
        said = frame.motions or ((Motion(frame.stamp_s, frame.speed_mps),) if frame.speed_mps is not None else ())
        curvature = curvature_of(frame.steering_rad, self._wheelbase_m)
        return [
            m if m.yaw_rate_rps is not None or m.speed_mps is None else replace(m, yaw_rate_rps=m.speed_mps * curvature)
            for m in said
        ]


class ScanMatching(Tracker):
    """KISS-ICP (Vizzo et al., IEEE RA-L 8(2), 2023): each sweep is laid on the map of those before it.

    Points with times are brought to the sweep's stamp first, by the motion before. As it begins, a speed that somebody
    has measured is that motion: KISS-ICP takes a car that begins at 20 m/s for one that stands. One thread, so that the
    same sweeps give the same poses. It holds Python's lock for the whole of a match:
    `vehicle_client.positioning.matching_process` has it in a process of its own.
    """

    def __init__(self, vehicle_from_sensor: Matrix) -> None:
        self._vehicle_from_sensor = vehicle_from_sensor
        self._matcher = _matcher()
        self._stamps_s: tuple[float, ...] = ()
        self._broken_off_s = -math.inf

    def odom_from_vehicle(self, frame: LidarFrame) -> Matrix | None:
        """(4, 4), in the car's frame at the first sweep; None where too few points came.

        After a gap in time, or a match that is no number, odometry begins anew, after a silence that nobody takes for a
        way.
        """
        if not is_gap(self._broken_off_s, frame.stamp_s) or frame.points_m.ndim != 2 or frame.points_m.shape[1] != 3:
            return None
        points = worth_matching(self._at_stamp(frame), self._vehicle_from_sensor[2])
        if len(points) < LEAST_POINTS:
            return None
        if self._stamps_s and is_gap(self._stamps_s[-1], frame.stamp_s):
            self._matcher, self._stamps_s = _matcher(), ()
        self._expect(frame)
        self._matcher.register_frame(points, np.empty(0))
        moved = np.asarray(self._matcher.last_pose, dtype=np.float64)
        if not np.isfinite(moved).all():
            self._matcher, self._stamps_s, self._broken_off_s = _matcher(), (), frame.stamp_s
            return None
        self._stamps_s = (*self._stamps_s[-1:], frame.stamp_s)
        return self._vehicle_from_sensor @ moved @ inverse(self._vehicle_from_sensor)

    def _expect(self, frame: LidarFrame) -> None:
        """KISS-ICP expects the motion before once more; where sweeps were left out, the car has gone on for longer."""
        twist = self._twist(frame)
        if twist is None or not self._stamps_s:
            return
        elapsed_s, before_s = frame.stamp_s - self._stamps_s[-1], self._stamps_s[-1] - self._stamps_s[0]
        if abs(elapsed_s - before_s) > UNEVEN * before_s:
            moved = twist.now_from_then(elapsed_s)
            # KISS-ICP ends the process for a turn that is one to seven digits only.
            turn = Rotation.from_matrix(moved[:3, :3]).as_matrix()
            self._matcher.last_delta = rigid(turn, moved[:3, 3])

    def _at_stamp(self, frame: LidarFrame) -> NDArray[np.float32]:
        twist = self._twist(frame)
        if frame.point_time_s is None or twist is None:
            return frame.points_m
        return deskew(frame.points_m, frame.point_time_s, twist)

    def _twist(self, frame: LidarFrame) -> Twist | None:
        """The sensor's motion until the sweep: between the two before it, else ahead, as fast as somebody says."""
        if len(self._stamps_s) < 2:
            speed_mps = measured_speed_mps(frame)
            if speed_mps is None or not FORWARD_MPS <= speed_mps < math.inf:
                return None
            return Twist(speed_mps * self._vehicle_from_sensor[0, :3], np.zeros(3))
        # Also over a long step: the mean motion is nearer to the next one than KISS-ICP's, which is the step itself.
        elapsed_s = self._stamps_s[1] - self._stamps_s[0]
        return twist_between(np.asarray(self._matcher.last_delta), elapsed_s, ODOMETRY_GAP_S)


def measured_speed_mps(frame: LidarFrame) -> float | None:
    """What the car, or else its receiver, says of its speed at a sweep."""
    if frame.speed_mps is not None or frame.gnss is None:
        return frame.speed_mps
    return frame.gnss.speed_mps


def _matcher() -> Any:
    from kiss_icp.config import KISSConfig
    from kiss_icp.kiss_icp import KissICP

    config = KISSConfig()
    config.mapping.voxel_size = VOXEL_M
    config.data.max_range = REACH_M
    config.data.deskew = False
    config.registration.convergence_criterion = CONVERGED
    config.registration.max_num_threads = 1
    return KissICP(config)


def is_gap(before_s: float, stamp_s: float) -> bool:
    """Whether odometry of two moments does not belong together, since too much time is between, or a clock's jump."""
    return not 0 <= stamp_s - before_s <= ODOMETRY_GAP_S


def tracker_for(
    frame: LidarFrame,
    vehicle_from_sensor: Matrix,
    wheelbase_m: float,
    matching: Callable[[Matrix], Tracker] = ScanMatching,
) -> Tracker:
    """What follows the car on a drive whose first frame this is: the source's odometry, wheels, or the sweeps.

    `matching` makes what follows the sweeps of a sensor at that place, `vehicle_from_sensor` (4, 4).
    """
    if frame.odom_from_vehicle is not None:
        return Given()
    if frame.motions or frame.speed_mps is not None:
        return Wheels(wheelbase_m)
    return matching(vehicle_from_sensor)
