"""What several sweeps saw together: the same hole, surer and from farther; bounded memory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from detector.errors import DetectorError
from detector.passes.accumulator import RECENT_FRAMES, Accumulator, accumulate
from detector.passes.height_grid import CELL_M, grid_frame
from detector.passes.over_frames import detect_over_frames
from detector.pipeline import detect
from detector.types import DetectedObstacle, DetectorInput
from tests.unit.detector.scenes import Block, Hole, Lidar, Street, cast

HOLE = Hole(24.0, -1.5, 0.9, 0.7, 0.15)


def pass_towards(street: Street, first_x: float, sweeps: int) -> tuple[Accumulator, DetectorInput]:
    state = Accumulator()
    for k in range(sweeps):
        points, pose = cast(street, Lidar(), first_x + 0.5 * k, -1.5, k)
        sweep = DetectorInput(points, 2.4, odom_from_sensor=pose)
        state = accumulate(state, sweep, detect(sweep))
    return state, sweep


def found(street: Street, first_x: float = 9.0, sweeps: int = RECENT_FRAMES) -> tuple[DetectedObstacle, ...]:
    state, sweep = pass_towards(street, first_x, sweeps)
    return detect_over_frames(state, sweep, detect(sweep))


def test_ten_sweeps_show_a_hole_ahead_where_it_is() -> None:
    (hole,) = found(Street(holes=(HOLE,)))
    assert hole.kind.is_negative
    assert hole.centre_m[0] == pytest.approx(24.0 - 13.5, abs=0.4)
    assert hole.centre_m[1] == pytest.approx(0.0, abs=0.3)
    assert hole.frames == RECENT_FRAMES


def test_ten_sweeps_show_a_box_as_a_rise() -> None:
    (box,) = found(Street(blocks=(Block(24.0, -1.2, 0.5, 0.4, 0.3),)))
    assert not box.kind.is_negative


def test_ten_sweeps_of_a_sound_road_show_nothing() -> None:
    assert found(Street()) == ()


def test_only_the_last_sweeps_are_kept() -> None:
    state, _ = pass_towards(Street(), 0.0, RECENT_FRAMES + 5)
    assert len(state.recent) == RECENT_FRAMES


def test_a_sweep_without_pose_is_refused() -> None:
    state, sweep = pass_towards(Street(), 0.0, 2)
    detection = detect(sweep)
    with pytest.raises(DetectorError, match="odom_from_sensor"):
        detect_over_frames(state, replace(sweep, odom_from_sensor=None), detection)


def test_a_grid_keeps_every_hit_of_the_strip_in_its_cell() -> None:
    rng = np.random.default_rng(0)
    points = rng.uniform(-20.0, 20.0, (5_000, 3)).astype(np.float32)
    residual = rng.normal(0.0, 0.01, 5_000).astype(np.float32)
    residual[::3] = np.nan
    frame = grid_frame(points, residual, np.eye(4))
    assert frame.hits.sum() == np.isfinite(residual).sum()
    assert frame.total_m.sum() == pytest.approx(np.nansum(residual, dtype=np.float64), abs=1e-6)
    cells = {tuple(c) for c in np.floor(points[np.isfinite(residual), :2].astype(np.float64) / CELL_M).astype(int)}
    assert {tuple(c) for c in np.floor(frame.centre_odom_m[:, :2] / CELL_M).astype(int)} == cells


def test_the_height_of_the_drive_above_its_origin_moves_nothing() -> None:
    state, sweep = pass_towards(Street(holes=(HOLE,)), 9.0, RECENT_FRAMES)
    (hole,) = detect_over_frames(state, sweep, detect(sweep))
    pitch = np.deg2rad(2.0)
    map_from_odom = np.array(
        [
            [np.cos(pitch), 0, np.sin(pitch), 40.0],
            [0, 1, 0, -7.0],
            [-np.sin(pitch), 0, np.cos(pitch), 300.0],
            [0, 0, 0, 1],
        ]
    )
    high = Accumulator()
    for k in range(RECENT_FRAMES):
        points, pose = cast(Street(holes=(HOLE,)), Lidar(), 9.0 + 0.5 * k, -1.5, k)
        sweep = DetectorInput(points, 2.4, odom_from_sensor=map_from_odom @ pose)
        high = accumulate(high, sweep, detect(sweep))
    (same,) = detect_over_frames(high, sweep, detect(sweep))
    assert same.centre_m[:2] == pytest.approx(hole.centre_m[:2], abs=0.15)


@pytest.mark.parametrize(
    "pose", [np.zeros((4, 4)), np.diag([1000.0, 1000.0, 1000.0, 1.0]), np.diag([1.0, 1.0, -1.0, 1.0])]
)
def test_what_is_no_rigid_transform_is_refused(pose: np.ndarray) -> None:
    points, _ = cast(Street(), Lidar(), 0.0, -1.5, 0)
    sweep = DetectorInput(points, 2.4, odom_from_sensor=pose)
    with pytest.raises(DetectorError, match="rigid"):
        accumulate(Accumulator(), sweep, detect(sweep))
