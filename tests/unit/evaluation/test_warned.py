"""How early drivers are warned: of what lies on the way, in bends too."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from evaluation.pose_drives import NO_POINTS, ORIGIN, PoseDrive, local_fix
from evaluation.pose_receivers import simulated_drive
from evaluation.warned import SEEN_FROM_M, SOON_S, SPACING_M, as_driven, straight_ahead, warned, warned_by_own
from headsup.cli import app
from tests.unit.vehicle_client.making import NOON_S, planar
from vehicle_client.sources.frame import LidarFrame


def test_with_the_bend_more_drivers_are_warned_in_time_and_the_same_seed_gives_the_same() -> None:
    drive = simulated_drive("memory of 100 s", 0, seconds=60.0)
    straight, bend = (warned(drive, way, seed=1) for way in (straight_ahead, as_driven))
    way_m = float(np.hypot(*np.diff(drive.place_m, axis=0).T).sum())
    assert straight.metres == bend.metres == pytest.approx(way_m)
    assert abs(len(bend.ahead_s) - (way_m / SPACING_M - 2)) <= 1
    assert (bend.ahead_s >= 0).all()
    assert (bend.ahead_s < SOON_S).all()
    assert (bend.ahead_s >= 2.5).sum() > (straight.ahead_s >= 2.5).sum()
    assert np.array_equal(warned(drive, as_driven, seed=1).ahead_s, bend.ahead_s)


def drive_along(corners_m: list[tuple[float, float]]) -> PoseDrive:
    """A drive at 10 m/s from corner to corner, with an exact receiver and exact odometry."""
    legs = [np.array([one, other], dtype=float) for one, other in pairwise(corners_m)]
    steps = [round(float(np.hypot(*(other - one)))) for one, other in legs]
    place_m = np.concatenate(
        [np.linspace(one, other, n, endpoint=False) for (one, other), n in zip(legs, steps, strict=True)]
    )
    yaw_rad = np.concatenate(
        [np.full(n, math.atan2(*(other - one)[::-1])) for (one, other), n in zip(legs, steps, strict=True)]
    )
    frames = tuple(
        LidarFrame(
            NOON_S + k / 10,
            NO_POINTS,
            odom_from_vehicle=planar(*place, yaw),
            gnss=replace(local_fix(ORIGIN, place, NOON_S + k / 10, 1.0), heading_rad=(math.pi / 2 - yaw) % math.tau),
        )
        for k, (place, yaw) in enumerate(zip(place_m, yaw_rad, strict=True))
    )
    return PoseDrive("corners", frames, ORIGIN, place_m, yaw_rad, np.full(len(place_m), 10.0))


def test_what_lies_straight_ahead_where_the_car_turns_is_a_wrong_warning() -> None:
    round_the_block = [(0, 0), (0, 200), (200, 200), (200, -150), (0, -150)]
    assert warned(drive_along([*round_the_block, (0, 200)]), as_driven, seed=1).wrong == 0
    turns_before = warned(drive_along([*round_the_block, (0, -25), (-80, -25)]), as_driven, seed=1)
    assert turns_before.wrong > 0


def test_by_the_own_lidar_too_fewer_are_warned_late_with_the_bend_and_of_less_beside_the_way() -> None:
    drive = simulated_drive("memory of 100 s", 3, seconds=240.0)
    straight, bend = (warned_by_own(drive, way, seed=1) for way in (straight_ahead, as_driven))
    assert np.array_equal(straight.believed_s, bend.believed_s)
    for of in (straight, bend):
        assert (of.ahead_s <= of.believed_s).all()
        assert (of.believed_s < SEEN_FROM_M).all()
    early = bend.believed_s >= 1.5
    assert (bend.ahead_s[early] < 1.5).sum() < (straight.ahead_s[early] < 1.5).sum()
    assert (bend.beside_ahead_s > 0).sum() < (straight.beside_ahead_s > 0).sum()
    assert bend.flickers <= straight.flickers


def test_on_a_straight_way_the_own_lidar_warns_of_all_that_lies_in_the_lane_and_of_nothing_beside_it() -> None:
    of = warned_by_own(drive_along([(0, 0), (300, 0)]), as_driven, seed=1)
    # Believed after three sweeps from within 25 m, at 10 m/s; and soon after the first pose is known.
    assert of.ahead_s[5:] == pytest.approx(of.believed_s[5:], abs=1e-6)
    assert of.believed_s[5:] == pytest.approx(2.25, abs=0.06)
    assert (len(of.beside_ahead_s), of.beside_ahead_s.max(), of.flickers) == (26, 0.0, 0)


def test_by_the_own_lidar_what_the_car_passes_on_its_way_back_is_no_thing_beside_nor_warned_of_before() -> None:
    to, fro = [(0, 0), (500, 0)], [(500, 5), (0, 5)]
    of = warned_by_own(drive_along(to + fro), as_driven, seed=1)
    alone = warned_by_own(drive_along(to), as_driven, seed=1)
    assert 0 < len(of.beside_ahead_s) < 1.5 * len(alone.beside_ahead_s)
    in_one_lane = warned_by_own(drive_along([(0, 0), (500, 0), (0, 0.5)]), as_driven, seed=1)
    assert max(of.ahead_s.max(), in_one_lane.ahead_s.max()) < SOON_S


def test_a_folder_without_the_drives_is_refused_with_what_is_missing(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["evaluate", "warned", "--data", str(tmp_path)])
    assert result.exit_code == 1
    assert f"neither drive_comma/drive.npz nor kitti00 under {tmp_path}" in result.output
    (tmp_path / "kitti00").mkdir()
    result = CliRunner().invoke(app, ["evaluate", "warned", "--data", str(tmp_path)])
    assert result.exit_code == 1
    assert "expected KITTI's poses" in result.output
