"""Drives with known poses: a recorded minute in a city, and recorded loops."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pymap3d
from numpy.typing import NDArray

from contract.geometry import LatLon
from vehicle_client.frames import GeoOrigin, rigid, rotation_about_z
from vehicle_client.positioning.pose_filter import DELAY_SD_S, KNOWN_DELAY_SD_S
from vehicle_client.sources.frame import GnssFix, LidarFrame, Motion, SourceError

FloatArray = NDArray[np.float64]

NO_POINTS = np.empty((0, 3), dtype=np.float32)

RECEIVER_SD_M = 1.891 / 2.448
"""Of an axis, since the recording states none: GPS.gov quotes the FAA's measurements of the standard service with
1.891 m for 95 % of places, and 2.448 is the radius of 95 % in standard deviations of an axis."""

RECEIVER_DELAY_S = 0.095
"""How long after its measurement a u-blox fix comes, as openpilot's localizer found for the device that drove here
(GPS_UBLOX_SENSOR_TIME_OFFSET)."""

STEERING_RATIO = 15.4
"""Steering wheel to front wheels of a Honda Civic, openpilot's table of cars."""

RECORDED = (
    "frame_times",
    "positions_ecef",
    "velocities",
    "gnss_t",
    "gnss",
    "speed_t",
    "speed",
    "steer_t",
    "steer",
)
"""The arrays of comma2k19's drive that are read here."""

ORIGIN = GeoOrigin(LatLon(latitude_deg=49.01, longitude_deg=8.43), 115.0)
"""Where simulated drives and KITTI's local metres are put on the earth: Karlsruhe."""


@dataclass(frozen=True, slots=True)
class PoseDrive:
    """Frames without points, and the truth at their stamps: (N, 2) east and north about `origin`, yaw (N,), speed.

    `delay_sd_s` is how well the moments of the fixes are known.
    """

    name: str
    frames: tuple[LidarFrame, ...]
    origin: GeoOrigin
    place_m: FloatArray
    yaw_rad: FloatArray
    speed_mps: FloatArray
    delay_sd_s: float = DELAY_SD_S


def recorded_city_drive(folder: Path, *, known_delay_s: float | None = None, steering: bool = True) -> PoseDrive:
    """comma2k19's minute: fixes with course as they arrived, less a delay if it is known; wheel speed, and the yaw rate
    of the steering angle or none at all."""
    path = folder / "drive_comma" / "drive.npz"
    try:
        with np.load(path) as file:
            data = {name: np.asarray(file[name], dtype=float) for name in RECORDED}
    except Exception as error:  # NumPy's and zipfile's parsers raise a dozen types where bytes make no sense
        raise SourceError(f"{path}: expected comma2k19's drive.npz ({error})") from error
    stamps, ecef = data["frame_times"], data["positions_ecef"]
    latitude, longitude, altitude = (np.asarray(v, dtype=float) for v in pymap3d.ecef2geodetic(*ecef.T))
    origin = GeoOrigin(LatLon(latitude_deg=latitude[0], longitude_deg=longitude[0]), float(altitude[0]))
    place = _enu(origin, ecef)
    velocity = _enu(origin, ecef + data["velocities"]) - place
    motions = _motions(data, steering=steering)
    fixes = [
        GnssFix(
            LatLon(latitude_deg=row[0], longitude_deg=row[1]),
            altitude_m=row[4],
            heading_rad=None,
            sd_m=RECEIVER_SD_M,
            altitude_sd_m=2 * RECEIVER_SD_M,
            course_rad=math.radians(row[5]),
            speed_mps=row[2],
            stamp_s=float(stamp) - (known_delay_s or 0.0),
        )
        for stamp, row in zip(data["gnss_t"], data["gnss"], strict=True)
    ]
    frames = _frames(stamps, fixes, motions, data["gnss_t"])
    yaw = np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0]))
    delay_sd_s = DELAY_SD_S if known_delay_s is None else KNOWN_DELAY_SD_S
    return PoseDrive("recorded, city", frames, origin, place[:, :2], yaw, np.hypot(*velocity[:, :2].T), delay_sd_s)


def _motions(data: dict[str, FloatArray], *, steering: bool) -> list[Motion]:
    """Wheel speed with the kinematic yaw rate of the front wheels: tires slip outwards, which the filter has to see."""
    wheels = np.radians(np.interp(data["speed_t"], data["steer_t"], data["steer"])) / STEERING_RATIO
    rates = data["speed"][:, 0] * np.tan(wheels) / 2.7 if steering else np.zeros(len(wheels))
    return [
        Motion(float(t), float(v), float(r))
        for t, v, r in zip(data["speed_t"], data["speed"][:, 0], rates, strict=True)
    ]


def _frames(
    stamps: FloatArray, fixes: list[GnssFix], motions: list[Motion], arrived_s: FloatArray
) -> tuple[LidarFrame, ...]:
    """A frame a stamp, each with the motions and the last fix that arrived since the one before."""
    frames, fix_at, motion_at = [], 0, 0
    for stamp in stamps:
        fix_until = int(np.searchsorted(arrived_s, stamp, side="right"))
        motion_until = motion_at
        while motion_until < len(motions) and motions[motion_until].stamp_s <= stamp:
            motion_until += 1
        fix = fixes[fix_until - 1] if fix_until > fix_at else None
        frames.append(LidarFrame(float(stamp), NO_POINTS, gnss=fix, motions=tuple(motions[motion_at:motion_until])))
        fix_at, motion_at = fix_until, motion_until
    return tuple(frames)


def _enu(origin: GeoOrigin, ecef: FloatArray) -> FloatArray:
    place = origin.position
    return np.stack(
        pymap3d.ecef2enu(*ecef.T, place.latitude_deg, place.longitude_deg, origin.altitude_m), axis=1
    ).astype(np.float64)


def recorded_loop_drive(folder: Path, seed: int) -> PoseDrive:
    """KITTI odometry's sequence 00: fixes at 1 Hz in local metres; odometry from a stereo SLAM's poses, drifting more.

    The truth is the SLAM's path laid on the fixes by one rigid motion; what is between them, some 2 m that change
    within a minute, is the drift of the SLAM, and plays the receiver's slow error. The fixes state just that.
    """
    where = folder / "kitti00"
    try:
        poses = np.loadtxt(where / "KITTI_00_SPTAM.txt").reshape(-1, 3, 4)
        stamps = np.loadtxt(where / "KITTI_00_gt_times.txt")
        fixes = np.loadtxt(where / "KittiGps_converted.txt", delimiter=",", skiprows=1)
    except (OSError, ValueError) as error:
        raise SourceError(f"{where}: expected KITTI's poses, times and converted fixes ({error})") from error
    # The camera's z is forward and its x to the right.
    path = np.stack([poses[:, 2, 3], -poses[:, 0, 3]], axis=1)
    ahead = np.unwrap(np.arctan2(-poses[:, 0, 2], poses[:, 2, 2]))
    start_s, turn, shift, residual = _laid_on(path, stamps, fixes)
    stamps = stamps + start_s
    place = path @ turn.T + shift
    yaw = ahead + math.atan2(turn[1, 0], turn[0, 0])
    sd_m = float(residual.std())
    odometry = drifting(place, yaw, np.random.default_rng([seed, 0]))
    spoken = [local_fix(ORIGIN, row[1:3], float(row[0]), sd_m) for row in fixes]
    frames = _with_odometry(_frames(stamps, spoken, [], fixes[:, 0]), odometry)
    speed = np.hypot(*np.gradient(place, stamps, axis=0).T)
    return PoseDrive("recorded, loops", frames, ORIGIN, place, yaw, speed)


def _laid_on(
    path: FloatArray, stamps: FloatArray, fixes: FloatArray
) -> tuple[float, FloatArray, FloatArray, FloatArray]:
    """When the path began by the fixes' clock, and the turn (2, 2) and shift (2,) that lay it on them; what is left."""
    best: tuple[float, float, FloatArray, FloatArray, FloatArray] | None = None
    for start_s in fixes[0, 0] + np.arange(-3.0, 3.0, 0.05):
        inside = (fixes[:, 0] >= start_s) & (fixes[:, 0] <= start_s + stamps[-1])
        there = np.stack([np.interp(fixes[inside, 0] - start_s, stamps, path[:, k]) for k in range(2)], axis=1)
        here = fixes[inside, 1:3]
        u, _, vt = np.linalg.svd((there - there.mean(axis=0)).T @ (here - here.mean(axis=0)))
        turn = vt.T @ np.diag([1.0, np.linalg.det(vt.T @ u.T)]) @ u.T
        shift = here.mean(axis=0) - turn @ there.mean(axis=0)
        residual = here - there @ turn.T - shift
        rms = float(np.sqrt((residual**2).mean()))
        if best is None or rms < best[0]:
            best = rms, float(start_s), turn, shift, residual
    assert best is not None  # noqa: S101  # 120 starts were tried
    return best[1:]


def local_fix(origin: GeoOrigin, enu_m: FloatArray, stamp_s: float, sd_m: float) -> GnssFix:
    """A fix (2,) east and north of an origin, and what it states of its error."""
    position, altitude_m = origin.geodetic(np.array([*enu_m, 0.0]))
    return GnssFix(position, altitude_m, None, sd_m, 2 * sd_m, stamp_s=stamp_s)


def _with_odometry(frames: tuple[LidarFrame, ...], odometry: FloatArray) -> tuple[LidarFrame, ...]:
    return tuple(replace(f, odom_from_vehicle=pose) for f, pose in zip(frames, odometry, strict=True))


def drifting(place_m: FloatArray, yaw_rad: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Odometry (N, 4, 4) of a true path (N, 2) with yaw (N,): a scale of 1 % and a turn of 1 degree in 100 m (1 sigma),
    constant on a drive, and noise that adds up to 0.3 degrees and 20 cm in 100 m."""
    step = np.diff(place_m, axis=0)
    way = np.hypot(*step.T)
    scale, turn_per_m = 1 + rng.normal(0, 0.01), rng.normal(0, math.radians(0.01))
    false_turn = np.cumsum(turn_per_m * way + rng.normal(0, math.radians(0.03), len(way)) * np.sqrt(way))
    start = -yaw_rad[0]
    turned = start + np.concatenate([[0.0], false_turn])
    cos, sin = np.cos(turned[:-1]), np.sin(turned[:-1])
    seen = scale * np.stack([cos * step[:, 0] - sin * step[:, 1], sin * step[:, 0] + cos * step[:, 1]], axis=1)
    seen += rng.normal(0, 0.02, seen.shape) * np.sqrt(way)[:, None]
    place = np.concatenate([np.zeros((1, 2)), np.cumsum(seen, axis=0)])
    return np.stack(
        [
            rigid(rotation_about_z(float(yaw + turn)), np.array([*at, 0.0]))
            for at, yaw, turn in zip(place, yaw_rad, turned, strict=True)
        ]
    )
