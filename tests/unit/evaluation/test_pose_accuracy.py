"""The pose is as right as it says: on drives with known truth, recorded and simulated."""

from __future__ import annotations

import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from evaluation.odometry_accuracy import MANOEUVRES, deskewed, matched, simulated_sweeps
from evaluation.pose_accuracy import DriveCounts, PoseTrace, counted, figures, inside_ellipse, traced
from evaluation.pose_drives import RECEIVER_DELAY_S, PoseDrive, recorded_city_drive, recorded_loop_drive
from evaluation.pose_receivers import RECEIVERS, REDRAWN, redrawn, simulated_drive
from headsup.cli import app
from simulator.mesh import pose as mounted
from vehicle_client.sources.frame import SourceError

DATA = Path(os.environ.get("HEADSUP_DATA", Path(__file__).parents[4] / "shared" / "data"))
needs_city = pytest.mark.skipif(not (DATA / "drive_comma").is_dir(), reason=f"no drive_comma under {DATA}")
needs_loops = pytest.mark.skipif(not (DATA / "kitti00").is_dir(), reason=f"no kitti00 under {DATA}")


def trace_of(error_m: np.ndarray, sd_m: float) -> PoseTrace:
    count = len(error_m)
    return PoseTrace(
        time_s=np.arange(count) / 10,
        error_m=error_m,
        covariance_m2=np.tile(sd_m**2 * np.eye(2), (count, 1, 1)),
        heading_error_rad=np.full(count, math.radians(0.5)),
        heading_sd_rad=np.full(count, math.radians(1.0)),
        jump_m=np.full(count, 0.02),
        speed_mps=np.full(count, 10.0),
        fix_time_s=np.arange(count) / 10,
        fix_error_m=error_m,
        reasons=(None,) * count,
    )


def every_fourth(drive: PoseDrive) -> PoseDrive:
    part = slice(None, None, 4)
    return replace(
        drive,
        frames=drive.frames[part],
        place_m=drive.place_m[part],
        yaw_rad=drive.yaw_rad[part],
        speed_mps=drive.speed_mps[part],
    )


def test_errors_drawn_from_the_stated_covariance_are_held_by_nineteen_in_twenty_ellipses() -> None:
    error = np.random.default_rng(1).normal(0, 0.7, (20_000, 2))
    assert inside_ellipse(trace_of(error, 0.7)).mean() == pytest.approx(0.95, abs=0.01)
    assert inside_ellipse(trace_of(error, 0.35)).mean() < 0.6


def test_moments_without_a_pose_count_as_such_and_as_nothing_else() -> None:
    error = np.vstack([np.full((50, 2), math.nan), np.full((50, 2), 0.3)])
    shown = figures([trace_of(error, 1.0)])
    assert shown.with_pose == 0.5
    assert shown.coverage == 1.0
    assert shown.median_m == pytest.approx(0.3 * math.sqrt(2))
    assert shown.heading_rms_deg == pytest.approx(0.5)


def test_each_drive_is_counted_by_its_share_in_the_ellipse() -> None:
    outside = [0, 0, 0, 1, 2, 10, 11, 100]
    traces = [trace_of(np.repeat([[9.0, 0.0], [0.1, 0.0]], [n, 100 - n], axis=0), 1.0) for n in outside]
    assert counted(traces) == DriveCounts(always=3, above=1, within=2, below=2)


def test_the_same_seed_gives_the_same_drive_and_another_one_another() -> None:
    one, again, other = (simulated_drive("white", seed, seconds=5.0) for seed in (1, 1, 2))
    assert [f.gnss for f in one.frames] == [f.gnss for f in again.frames]
    assert np.array_equal(one.place_m, again.place_m)
    assert not np.array_equal(one.place_m, other.place_m)


@pytest.mark.parametrize("receiver", ["white", "memory of 100 s"])
def test_whatever_a_receiver_s_error_is_like_the_ellipse_holds_the_truth(receiver: str) -> None:
    shown = figures([traced(simulated_drive(receiver, seed, seconds=60.0)) for seed in (11, 12, 13)])
    assert shown.coverage >= 0.9
    assert shown.with_pose > 0.98
    assert shown.heading_rms_deg < 1.0


def test_white_noise_is_averaged_away_and_a_slow_error_is_not_claimed_to_be() -> None:
    white, slow = (traced(simulated_drive(name, 11, seconds=60.0)) for name in ("white", "memory of 100 s"))
    white_sd, slow_sd = (math.sqrt(float(np.trace(t.covariance_m2[-1])) / 2) for t in (white, slow))
    assert figures([white]).median_m < 0.5 * figures([white]).raw_median_m
    assert white_sd < 0.5 < 0.7 < slow_sd


def test_reflections_of_fifty_metres_move_no_pose_by_more_than_the_receiver_s_own_error() -> None:
    drive = simulated_drive("100 s, jumps of 50 m", 11, seconds=60.0)
    shown = traced(drive)
    assert np.hypot(*shown.fix_error_m.T).max() > 45
    assert np.nanmax(np.hypot(*shown.error_m.T)) < 3


def test_warnings_do_not_jump() -> None:
    shown = figures([traced(simulated_drive("memory of 100 s", 11, seconds=60.0))])
    assert shown.jump_p99_m < 0.6


def test_a_receiver_that_stamps_late_costs_no_metres_behind_the_car() -> None:
    drives = [simulated_drive("100 s, stamped 0.2 s late", seed, seconds=60.0) for seed in (11, 12, 13)]
    shown = figures([traced(every_fourth(drive)) for drive in drives])
    assert shown.median_m < 0.8 * shown.raw_median_m
    assert shown.heading_rms_deg < 1.0


def test_nothing_but_the_errors_of_the_fixes_is_drawn_anew() -> None:
    recorded = simulated_drive("100 s, outage of 60 s", 11, seconds=70.0)
    one, again, other = (redrawn(recorded, "memory of 30 s", seed) for seed in (1, 1, 2))
    assert one.frames == again.frames
    for frame, before, elsewhere in zip(one.frames, recorded.frames, other.frames, strict=True):
        assert replace(frame, gnss=None) == replace(before, gnss=None)
        if frame.gnss is None or before.gnss is None or elsewhere.gnss is None:
            assert frame.gnss is before.gnss is elsewhere.gnss
            continue
        assert (frame.gnss.stamp_s, frame.gnss.sd_m) == (before.gnss.stamp_s, before.gnss.sd_m)
        assert len({fix.position for fix in (frame.gnss, before.gnss, elsewhere.gnss)}) == 3


@pytest.mark.parametrize("stated_m", [0.8, 3.0])
def test_drawn_errors_are_as_large_as_the_fixes_state(stated_m: float) -> None:
    whole = simulated_drive("white", 11, seconds=2.0)
    fixes = [frame.gnss for frame in whole.frames if frame.gnss is not None]
    stated = [replace(frame, gnss=replace(fix, sd_m=stated_m)) for frame, fix in zip(whole.frames, fixes, strict=True)]
    drives = [redrawn(replace(whole, frames=tuple(stated)), "memory of 30 s", seed) for seed in range(100)]
    error = np.concatenate([traced(drive).fix_error_m for drive in drives])
    assert math.sqrt(float((error**2).mean())) == pytest.approx(stated_m, rel=0.15)


def test_every_receiver_that_is_drawn_on_recorded_drives_is_known() -> None:
    assert set(REDRAWN) < set(RECEIVERS)


def test_every_kind_of_receiver_is_simulated() -> None:
    assert {"white", "memory of 30 s", "memory of 100 s", "100 s, stamped 0.1 s late"} < set(RECEIVERS)


@pytest.mark.realdata
@needs_city
def test_on_the_recorded_city_drive_the_pose_is_honest_and_heads_right() -> None:
    shown = figures([traced(recorded_city_drive(DATA))])
    assert shown.coverage >= 0.9
    assert shown.median_m < 0.5 * shown.raw_median_m
    assert shown.heading_rms_deg < 1.0
    assert shown.with_pose > 0.98


@pytest.mark.realdata
@needs_city
def test_a_known_delay_of_the_receiver_takes_most_of_its_error() -> None:
    drive = recorded_city_drive(DATA, known_delay_s=RECEIVER_DELAY_S)
    assert figures([traced(drive)]).median_m < 0.5


@pytest.mark.realdata
@needs_city
def test_a_receiver_drawn_on_the_recorded_street_is_found_to_stamp_late() -> None:
    recorded = recorded_city_drive(DATA)
    shown = figures([traced(redrawn(recorded, "100 s, stamped 0.1 s late", seed)) for seed in (0, 1)])
    assert shown.coverage >= 0.9
    assert shown.median_m < 0.8 * shown.raw_median_m
    assert shown.heading_rms_deg < 1.0


@pytest.mark.realdata
@needs_loops
def test_on_recorded_loops_with_a_fix_a_second_the_pose_is_honest() -> None:
    whole = recorded_loop_drive(DATA, seed=1)
    part = slice(0, 1_500)
    drive = replace(
        whole,
        frames=whole.frames[part],
        place_m=whole.place_m[part],
        yaw_rad=whole.yaw_rad[part],
        speed_mps=whole.speed_mps[part],
    )
    shown = figures([traced(drive)])
    assert shown.coverage > 0.85
    assert shown.heading_rms_deg < 1.0


def test_a_folder_that_is_not_the_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"drive\.npz"):
        recorded_city_drive(tmp_path)
    (tmp_path / "drive_comma").mkdir()
    path = tmp_path / "drive_comma" / "drive.npz"
    np.savez(path, frame_times=np.arange(3.0))
    whole = path.read_bytes()
    for bytes_there in (whole, whole[: len(whole) // 2], b""):
        path.write_bytes(bytes_there)
        with pytest.raises(SourceError, match=r"drive\.npz: expected comma2k19's"):
            recorded_city_drive(tmp_path)
    (tmp_path / "kitti00").mkdir()
    with pytest.raises(SourceError, match="KITTI"):
        recorded_loop_drive(tmp_path, seed=1)


def test_without_recordings_the_command_says_what_it_looked_for(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["evaluate", "pose", "--data", str(tmp_path)])
    assert result.exit_code == 1
    assert "drive_comma" in result.output
    assert "Traceback" not in result.output


def test_the_motion_of_a_corner_is_taken_out_of_a_rolling_sweep() -> None:
    turn = deskewed(MANOEUVRES[-1], seed=1)
    assert np.percentile(turn.raw_error_m, 95) > 0.5
    assert turn.error_m.max() < 0.01


def test_sweeps_alone_tell_the_way_of_a_rolling_sensor() -> None:
    mounting = mounted(0.0, 0.0, 1.73)
    drive = matched("street", simulated_sweeps(20.0, 10.0, 1, times=True), mounting)
    assert drive.length_m == pytest.approx(14.0, rel=0.05)
    assert drive.drift_percent < 3.0
