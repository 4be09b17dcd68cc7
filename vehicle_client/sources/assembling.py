"""Readings of all sensors, in the order they come, joined into frames: each sweep with what came since the last."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from vehicle_client.frames import Matrix, rigid
from vehicle_client.sources.complaints import Complaints
from vehicle_client.sources.frame import GnssFix, LidarFrame, Motion, SourceError
from vehicle_client.sources.mounting import Lever
from vehicle_client.sources.readings import GroundVelocity, Heading, Odometry, Picture, Reading, Steering
from vehicle_client.sources.stamps import StampGate

MOST_MOTIONS = 2_000
"""Kept between two sweeps: 2 s of the fastest inertial unit. Without sweeps they must not pile up."""

TOGETHER_S = 0.2
"""A heading or course belongs to a fix that is no farther away in time: two periods of a slow receiver."""

ODOMETRY_WITHIN_S = 0.25
"""A pose is carried on by its last motion for so long: at 1 m/s2 it is 3 cm off then."""

BASE_S = 0.05
"""A motion is carried on from poses so far apart: nearer ones would make their noise many times larger."""

MOST_FIXES = 100
"""Kept between two sweeps: 4 s of the fastest receiver."""

MOST_POSES = 100
"""Of the fastest odometry half a second."""

SPEED_WITHIN_S = 1.0
"""A speed older than this says nothing of now."""


@dataclass(slots=True)
class Assembler:
    """Joins readings into frames with stamps that rise.

    A frame brings the sweep, the last picture since the sweep before, all fixes and motions since then in the order of
    time, and the pose by odometry at its own stamp.
    """

    complaints: Complaints
    lever: Lever = field(default_factory=Lever)
    gate: StampGate = field(default_factory=StampGate)
    _picture: Picture | None = field(default=None, init=False)
    _fix: GnssFix | None = field(default=None, init=False)
    _earlier: deque[GnssFix] = field(default_factory=lambda: deque(maxlen=MOST_FIXES), init=False)
    _heading: Heading | None = field(default=None, init=False)
    _velocity: GroundVelocity | None = field(default=None, init=False)
    _motions: deque[Motion] = field(default_factory=lambda: deque(maxlen=MOST_MOTIONS), init=False)
    _speed: Motion | None = field(default=None, init=False)
    _poses: deque[Odometry] = field(default_factory=lambda: deque(maxlen=MOST_POSES), init=False)
    _steering_rad: float = field(default=0.0, init=False)

    def frames(self, readings: Iterable[Reading]) -> Iterator[LidarFrame]:
        """All frames of a sequence of readings."""
        for reading in readings:
            frame = self.add(reading)
            if frame is not None:
                yield frame

    def add(self, reading: Reading) -> LidarFrame | None:
        """Take a reading in; a sweep whose stamp can follow gives a frame."""
        match reading:
            case LidarFrame():
                return self._frame(reading)
            case Picture():
                self._picture = reading
            case GnssFix():
                self._add_fix(reading)
            case Heading():
                self._heading = reading
            case GroundVelocity():
                self._velocity = reading
            case Motion():
                self._motions.append(reading)
                self._speed = self._speed if reading.speed_mps is None else reading
            case Odometry():
                self._add_pose(reading)
            case Steering():
                self._steering_rad = reading.steering_rad
        return None

    def _frame(self, sweep: LidarFrame) -> LidarFrame | None:
        refusal = self.gate.refusal(sweep.stamp_s)
        if refusal is not None:
            self.complaints.add(f"a sweep is left out: {refusal}")
            return None
        picture, self._picture = self._picture, None
        fix, self._fix = self._fix, None
        earlier = tuple(self._earlier)
        self._earlier.clear()
        motions = tuple(sorted(self._motions, key=lambda motion: motion.stamp_s))
        self._motions.clear()
        image = self._decoded(picture)
        return replace(
            sweep,
            image=image,
            image_stamp_s=None if image is None or picture is None else picture.stamp_s,
            gnss=None if fix is None else self._with_direction(fix, sweep.stamp_s),
            earlier_fixes=earlier,
            motions=motions,
            odom_from_vehicle=pose_at(tuple(self._poses), sweep.stamp_s),
            speed_mps=self._speed_at(sweep.stamp_s),
            steering_rad=self._steering_rad,
        )

    def _decoded(self, picture: Picture | None) -> NDArray[np.uint8] | None:
        try:
            return None if picture is None else picture.decode()
        except SourceError as error:
            self.complaints.add(f"a picture is left out: {error}")
            return None

    def _with_direction(self, fix: GnssFix, stamp_s: float) -> GnssFix:
        """The fix of the vehicle's origin, with heading and course that other topics said at its time."""
        at_s = stamp_s if fix.stamp_s is None else fix.stamp_s
        if fix.heading_rad is None and self._heading and abs(self._heading.stamp_s - at_s) <= TOGETHER_S:
            fix = replace(fix, heading_rad=(self._heading.heading_rad + self.lever.imu_yaw_rad) % (2 * math.pi))
        velocity = self._velocity
        if fix.course_rad is None and velocity and abs(velocity.stamp_s - at_s) <= TOGETHER_S:
            fix = replace(fix, course_rad=velocity.course_rad, speed_mps=velocity.speed_mps)
        return self.lever.moved(fix)

    def _speed_at(self, stamp_s: float) -> float | None:
        latest = (
            (said.stamp_s, said.speed_mps)
            for said in (self._poses[-1] if self._poses else None, self._speed, self._velocity)
            if said is not None and said.speed_mps is not None and abs(stamp_s - said.stamp_s) <= SPEED_WITHIN_S
        )
        return next((speed for _, speed in latest), None)

    def _add_fix(self, fix: GnssFix) -> None:
        """A fix; the one before it has heard what other topics say of its time. Only the last may have no stamp."""
        if self._fix is not None and self._fix.stamp_s is not None:
            self._earlier.append(self._with_direction(self._fix, self._fix.stamp_s))
        self._fix = fix

    def _add_pose(self, pose: Odometry) -> None:
        if self._poses and pose.stamp_s <= self._poses[-1].stamp_s:
            self._poses.clear()  # said twice, or the clock was set back: begin again
        self._poses.append(pose)


def pose_at(poses: Sequence[Odometry], stamp_s: float) -> Matrix | None:
    """`odom_from_vehicle` at a moment by the motion between two poses; None where they are too far from it in time."""
    if not poses or not -ODOMETRY_WITHIN_S <= stamp_s - poses[-1].stamp_s <= ODOMETRY_WITHIN_S:
        return None
    after = next((i for i, pose in enumerate(poses) if pose.stamp_s >= stamp_s), len(poses) - 1)
    last = poses[after]
    base_s = last.stamp_s - (0.0 if last.stamp_s >= stamp_s else BASE_S)
    first = next((pose for pose in reversed(poses[:after]) if pose.stamp_s <= base_s), poses[0])
    if not 0 < last.stamp_s - first.stamp_s <= ODOMETRY_WITHIN_S:
        return last.odom_from_vehicle
    share = (stamp_s - first.stamp_s) / (last.stamp_s - first.stamp_s)
    start, end = first.odom_from_vehicle, last.odom_from_vehicle
    turn = Rotation.from_matrix(start[:3, :3].T @ end[:3, :3]).as_rotvec() * share
    moved = start[:3, 3] + share * (end[:3, 3] - start[:3, 3])
    return rigid(start[:3, :3] @ Rotation.from_rotvec(turn).as_matrix(), moved)
