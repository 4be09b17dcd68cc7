"""Map and registration take KISS-ICP's place: they give what it gives."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kiss_icp.config import KISSConfig
from kiss_icp.mapping import VoxelHashMap
from kiss_icp.registration import Registration as KissRegistration
from scipy.spatial.transform import Rotation

from vehicle_client.frames import Matrix, apply, inverse, rigid
from vehicle_client.positioning.registration import MOST_STEPS, Registration
from vehicle_client.positioning.voxel_map import VoxelMap

REACH_M = 40.0
CONVERGED = 1e-4
REGISTRATION = KissRegistration(MOST_STEPS, CONVERGED, max_num_threads=1)


def street(seed: int, number: int = 4_000) -> Matrix:
    """Walls on both sides, a gable, and what stands about."""
    random = np.random.default_rng(seed)
    along, height = random.uniform(-30, 30, number), random.uniform(0, 4, number)
    walls = np.column_stack([along, np.where(random.random(number) < 0.5, -8.0, 9.0), height])
    gable = np.column_stack([np.full(number // 4, 25.0), *random.uniform([-8, 0], [9, 6], (number // 4, 2)).T])
    things = random.uniform([-30, -8, 0], [30, 9, 3], (number // 4, 3))
    return np.vstack([walls, gable, things])


def maps(*updates: tuple[Matrix, Matrix]) -> tuple[VoxelMap, VoxelHashMap]:
    ours, theirs = VoxelMap(1.0, REACH_M, 20), VoxelHashMap(1.0, REACH_M, 20)
    for points, map_from_sensor in updates:
        ours.update(points, map_from_sensor)
        theirs.update(points, map_from_sensor)
    return ours, theirs


def held(ours: VoxelMap) -> Matrix:
    voxels = ours.voxels
    there = voxels.row[voxels.row >= 0]
    return np.vstack([np.empty((0, 3)), *(voxels.points_m[row, : voxels.number[row]] for row in there)])


def in_order(points: Matrix) -> Matrix:
    return points[np.lexsort(points.T)]


def moved(x: float, y: float, yaw: float, pitch: float = 0.0) -> Matrix:
    return rigid(Rotation.from_euler("ZY", [yaw, pitch]).as_matrix(), np.array([x, y, 0.1]))


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.lists(st.floats(-60, 60), min_size=1, max_size=4))
def test_a_map_holds_what_that_of_kiss_icp_holds_and_forgets_with_it(seed: int, places: list[float]) -> None:
    ours, theirs = maps(*((street(seed + k, 800), moved(x, -x / 3, x / 10)) for k, x in enumerate(places)))
    assert in_order(held(ours)) == pytest.approx(in_order(np.asarray(theirs.point_cloud())), abs=1e-9)


def test_a_map_grows_beyond_its_first_size_and_finds_all_of_it_again() -> None:
    grid = np.stack(np.meshgrid(*[np.arange(-16.0, 16.0)] * 3), axis=-1).reshape(-1, 3) + 0.5
    ours, theirs = maps((grid, np.eye(4)), (grid + 0.4, np.eye(4)))
    assert len(held(ours)) == 2 * len(grid)
    assert in_order(held(ours)) == pytest.approx(in_order(np.asarray(theirs.point_cloud())), abs=1e-9)


@pytest.mark.parametrize("gates", [(0.3, 0.1), (1.2, 0.4), (6.0, 2.0)])
@pytest.mark.parametrize("far", [0.0, 30_000.0])
def test_a_sweep_is_laid_where_kiss_icp_lays_it(gates: tuple[float, float], far: float) -> None:
    """From good and bad guesses, with narrow and wide gates, near the map's origin and far from it."""
    guess = moved(far, -far, 0.3)
    ours, theirs = maps((street(1), guess))
    random = np.random.default_rng(7)
    for seed in range(2, 6):
        missed = moved(*random.uniform([-1.5, -0.5, -0.05, -0.02], [1.5, 0.5, 0.05, 0.02]))
        sweep = apply(inverse(missed), street(seed)[::3])
        found = Registration(CONVERGED).align_points_to_map(sweep, ours, guess, *gates)
        expected = REGISTRATION.align_points_to_map(sweep, theirs, guess, *gates)
        assert np.abs(apply(found, sweep) - apply(expected, sweep)).max() < 1e-8
        assert found[:3, :3] @ found[:3, :3].T == pytest.approx(np.eye(3), abs=1e-12)


def test_with_nothing_in_the_map_or_nothing_near_it_the_guess_stays() -> None:
    guess, sweep = moved(3.0, 1.0, 0.2), street(1)
    nothing, _ = maps()
    assert np.array_equal(Registration(CONVERGED).align_points_to_map(sweep, nothing, guess, 1.0, 0.3), guess)
    ours, _ = maps((street(1), np.eye(4)))
    high = sweep + np.array([0.0, 0.0, 500.0])
    assert Registration(CONVERGED).align_points_to_map(high, ours, guess, 1.0, 0.3) == pytest.approx(guess)


def test_points_that_do_not_say_where_the_sensor_is_give_no_number() -> None:
    ours, _ = maps((np.array([[5.0, 0.0, 1.0]]), np.eye(4)))
    one = np.array([[5.2, 0.0, 1.0]])
    found = Registration(CONVERGED).align_points_to_map(one, ours, np.eye(4), 1.0, 0.3)
    assert not np.isfinite(found[:3]).any()


def test_kiss_icp_ends_after_as_many_steps() -> None:
    assert KISSConfig().registration.max_num_iterations == MOST_STEPS
