"""Drives with known poses whose receivers err in known ways: simulated ones, and recorded ones with errors drawn."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from evaluation.pose_drives import NO_POINTS, ORIGIN, PoseDrive, drifting, local_fix
from vehicle_client.frames import heading_from_yaw
from vehicle_client.sources.frame import GnssFix, LidarFrame

FloatArray = NDArray[np.float64]

Errors = Callable[[FloatArray, np.random.Generator], FloatArray]
"""Errors (N, 2) of fixes at times (N,); a row of NaN is no fix."""


def white(times_s: FloatArray, rng: np.random.Generator) -> FloatArray:
    """New with every fix."""
    return rng.normal(0, 1.0, (len(times_s), 2))


def slow(memory_s: float) -> Errors:
    """A first-order Gauss-Markov process of 1 m, with a tenth of white noise (variances sum to 1)."""

    def errors(times_s: FloatArray, rng: np.random.Generator) -> FloatArray:
        process = np.empty((len(times_s), 2))
        process[0] = rng.normal(0, 1.0, 2)
        for k, elapsed in enumerate(np.diff(times_s)):
            kept = math.exp(-elapsed / memory_s)
            process[k + 1] = kept * process[k] + math.sqrt(1 - kept**2) * rng.normal(0, 1.0, 2)
        return math.sqrt(0.99) * process + rng.normal(0, 0.1, process.shape)

    return errors


def with_jumps(errors: Errors) -> Errors:
    """A reflection of 50 m for 1.5 s about every 40 s."""

    def jumping(times_s: FloatArray, rng: np.random.Generator) -> FloatArray:
        wrong = errors(times_s, rng)
        start = times_s[0] + 20.0
        while start < times_s[-1]:
            towards = rng.uniform(0, 2 * math.pi)
            wrong[(times_s >= start) & (times_s < start + 1.5)] += 50 * np.array([math.cos(towards), math.sin(towards)])
            start += rng.uniform(30, 50)
        return wrong

    return jumping


def with_outage(errors: Errors) -> Errors:
    """No fix for a minute in the middle, as in a tunnel."""

    def silent(times_s: FloatArray, rng: np.random.Generator) -> FloatArray:
        wrong = errors(times_s, rng)
        middle = times_s.mean()
        wrong[np.abs(times_s - middle) < 30.0] = math.nan
        return wrong

    return silent


@dataclass(frozen=True, slots=True)
class Receiver:
    """How its fixes err, and how long after the moment of a fix its stamp is."""

    errors: Errors
    delay_s: float = 0.0


RECEIVERS: dict[str, Receiver] = {
    "white": Receiver(white),
    "memory of 30 s": Receiver(slow(30.0)),
    "memory of 100 s": Receiver(slow(100.0)),
    "memory of 600 s": Receiver(slow(600.0)),
    "100 s, jumps of 50 m": Receiver(with_jumps(slow(100.0))),
    "100 s, outage of 60 s": Receiver(with_outage(slow(100.0))),
    "100 s, stamped 0.1 s late": Receiver(slow(100.0), delay_s=0.1),
    "100 s, stamped 0.2 s late": Receiver(slow(100.0), delay_s=0.2),
}
"""Each states 1 m, and is right about it."""

REDRAWN = ("memory of 30 s", "memory of 100 s", "memory of 600 s", "100 s, stamped 0.1 s late")
"""What a receiver on a recorded street may be like: its errors last, and it stamps at once or on arrival."""

STAMP_JITTER_S = 0.02
"""Stamps taken on arrival shake so much: serial lines and schedulers."""

VELOCITY_SD_MPS, VELOCITY_LAG_S = 0.074, 0.08
"""u-blox's M8 data sheet has 0.05 m/s for half of the velocities, 0.074 for one deviation; of an LEA-5H a user measured
velocities 77 ms later than places (DIY Drones, "Ublox 5 velocity & position")."""


def simulated_drive(receiver: str, seed: int, *, seconds: float = 180.0) -> PoseDrive:
    """A town drive with corners and stops: 10 frames and 10 fixes a second, `drifting` odometry."""
    rng = np.random.default_rng([seed, 1, list(RECEIVERS).index(receiver)])
    times = np.arange(0.0, seconds, 0.1)
    speed, rate = _driving(times, rng)
    yaw = rng.uniform(-math.pi, math.pi) + np.cumsum(rate) * 0.1
    velocity = speed[:, None] * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    place = np.cumsum(velocity * 0.1, axis=0)
    silent = tuple(LidarFrame(1.0e9 + float(time), NO_POINTS) for time in times)
    drive = PoseDrive(f"simulated, {receiver}", silent, ORIGIN, place, yaw, speed)
    fixes = _fixes(RECEIVERS[receiver], drive, 1.0e9 + times, np.ones(len(times)), rng)
    frames = tuple(
        replace(frame, odom_from_vehicle=odom_from_vehicle, gnss=fix)
        for frame, odom_from_vehicle, fix in zip(silent, drifting(place, yaw, rng), fixes, strict=True)
    )
    return replace(drive, frames=frames)


def redrawn(recorded: PoseDrive, receiver: str, seed: int) -> PoseDrive:
    """A recorded drive on which nothing but the errors of its fixes is drawn: as large as they were stated.

    Path, wheels, frames and the stamps of the fixes stay; another seed is another receiver on the same street.
    """
    rng = np.random.default_rng([seed, 2, list(RECEIVERS).index(receiver)])
    spoken = [(k, frame.gnss) for k, frame in enumerate(recorded.frames) if frame.gnss is not None]
    stamps = np.array([recorded.frames[k].stamp_s if fix.stamp_s is None else fix.stamp_s for k, fix in spoken])
    fixes = _fixes(RECEIVERS[receiver], recorded, stamps, np.array([fix.sd_m for _, fix in spoken]), rng)
    frames = list(recorded.frames)
    for (k, _), fix in zip(spoken, fixes, strict=True):
        frames[k] = replace(frames[k], gnss=fix)
    return replace(recorded, name=f"{recorded.name}, {receiver}", frames=tuple(frames))


def _fixes(
    receiver: Receiver, drive: PoseDrive, stamps_s: FloatArray, sd_m: FloatArray, rng: np.random.Generator
) -> list[GnssFix | None]:
    """A fix with course and speed for each stamp (F,), of what was a delay ago; None where there is none.

    `sd_m` (F,) is what the fixes state, and what the receiver's errors are multiplied by.
    """
    times_s = np.array([frame.stamp_s for frame in drive.frames])
    velocity_mps = drive.speed_mps[:, None] * np.stack([np.cos(drive.yaw_rad), np.sin(drive.yaw_rad)], axis=1)
    wrong = sd_m[:, None] * receiver.errors(stamps_s, rng)
    moments = stamps_s - receiver.delay_s + rng.normal(0, STAMP_JITTER_S, len(stamps_s))
    places = _at(moments, times_s, drive.place_m) + wrong
    velocities = _at(moments - VELOCITY_LAG_S, times_s, velocity_mps) + rng.normal(0, VELOCITY_SD_MPS, wrong.shape)
    return [
        replace(
            local_fix(drive.origin, place, float(stamp), float(sd)),
            course_rad=heading_from_yaw(math.atan2(velocity[1], velocity[0])),
            speed_mps=float(np.hypot(*velocity)),
        )
        if np.isfinite(place).all()
        else None
        for stamp, sd, place, velocity in zip(stamps_s, sd_m, places, velocities, strict=True)
    ]


def _at(moments_s: FloatArray, times_s: FloatArray, values: FloatArray) -> FloatArray:
    return np.stack([np.interp(moments_s, times_s, values[:, axis]) for axis in range(2)], axis=1)


def _driving(times_s: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Speed (N,) between stops of some seconds, and yaw rate (N,) with a corner every half minute."""
    speed, rate = np.empty(len(times_s)), np.zeros(len(times_s))
    wanted, now, next_s = 13.0, 8.0, 10.0
    for k, t in enumerate(times_s):
        if t >= next_s:
            wanted = 0.0 if wanted > 0 and rng.random() < 0.3 else float(rng.uniform(8, 16))
            next_s = t + rng.uniform(6, 15)
        now += float(np.clip(wanted - now, -0.2, 0.15))
        speed[k] = now
    corner = 12.0
    while corner < times_s[-1] - 6:
        inside = (times_s >= corner) & (times_s < corner + 5)
        rate[inside] += rng.choice([-1, 1]) * math.radians(rng.uniform(8, 18)) * np.minimum(1, speed[inside] / 8)
        corner += rng.uniform(15, 40)
    return speed, rate
