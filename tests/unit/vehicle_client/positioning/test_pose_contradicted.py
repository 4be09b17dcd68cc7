"""The car's pose where fixes and odometry contradict each other: reflections, wrong starts, odometry begun anew."""

from __future__ import annotations

import numpy as np
import pytest

from tests.unit.vehicle_client.making import NOON_S, planar
from tests.unit.vehicle_client.positioning.pose_drives import (
    EAST,
    RATE_HZ,
    along_x,
    east_north_m,
    fix_at,
    frame_at,
    without_fixes,
)
from vehicle_client.positioning.pose import (
    PoseFilter,
    PoseUpdate,
    update,
)


@pytest.mark.parametrize("jump_m", [15.0, 50.0, 5_000.0])
def test_a_reflection_does_not_move_the_pose(jump_m: float) -> None:
    state, _ = along_x(100)
    _, found = along_x(15, first=100, state=state, north_m=jump_m)
    assert east_north_m(found) == pytest.approx([114, 0], abs=0.5)


def test_while_fixes_contradict_odometry_for_long_there_is_no_pose_until_they_agree() -> None:
    state, _ = along_x(100)
    state, doubted = along_x(30, first=100, state=state, north_m=50.0)
    assert doubted == PoseUpdate(None, "satellite fixes contradict odometry")
    _, moved = along_x(40, first=130, state=state, north_m=50.0)
    assert east_north_m(moved) == pytest.approx([169, 50], abs=0.5)


def test_a_reflection_before_a_tunnel_costs_no_pose_in_it() -> None:
    """One fix that is not believed, and then none: nothing contradicts the pose any more."""
    state, _ = along_x(100)
    state, _ = along_x(1, first=100, state=state, north_m=50.0)
    _, found = without_fixes(state, 101, 50)
    assert found.reason is None
    assert east_north_m(found) == pytest.approx([150, 0], abs=0.5)


def test_a_reflection_at_either_end_of_a_tunnel_does_not_move_the_pose() -> None:
    state, _ = along_x(100)
    state, _ = along_x(1, first=100, state=state, north_m=50.0)
    state, _ = without_fixes(state, 101, 250)
    state, _ = along_x(3, first=351, state=state, north_m=-80.0)
    _, found = along_x(5, first=354, state=state)
    assert east_north_m(found) == pytest.approx([358, 0], abs=1.0)


def test_fixes_that_jump_about_never_win() -> None:
    state, random = along_x(100)[0], np.random.default_rng(3)
    for number in range(100, 200):
        far = 60 * random.uniform(-1, 1, 2) + [0, 100]
        fix = fix_at(number + far[0], far[1], EAST)
        state, _ = update(state, frame_at(NOON_S + number / RATE_HZ, planar(number, 0, 0.0), fix))
    _, found = along_x(1, first=200, state=state)
    assert east_north_m(found) == pytest.approx([200, 0], abs=0.5)


def test_a_frozen_receiver_is_not_believed() -> None:
    state, _ = along_x(100)
    for number in range(100, 400):
        frozen = fix_at(99, 0, EAST)
        state, found = update(state, frame_at(NOON_S + number / RATE_HZ, planar(number, 0, 0.0), frozen))
        if found.pose is not None:
            assert east_north_m(found)[0] == pytest.approx(number, abs=2.5)


def test_a_wrong_first_place_is_left_when_fixes_agree_on_another() -> None:
    state, _ = along_x(1, north_m=300.0)
    _, found = along_x(80, first=1, state=state)
    assert east_north_m(found) == pytest.approx([80, 0], abs=0.5)


def test_a_wrong_heading_at_the_start_is_found_out() -> None:
    """Said west, driven east: fixes contradict odometry ever more, until the pose begins anew."""
    state, _ = update(PoseFilter(), frame_at(NOON_S, planar(0, 0, 0.0), fix_at(0, 0, -EAST)))
    state, _ = along_x(300, first=1, state=state, heading=None)
    _, found = along_x(300, first=301, state=state, heading=None)
    assert found.pose is not None, found.reason
    assert found.pose.heading_rad == pytest.approx(EAST, abs=0.03)
    assert east_north_m(found) == pytest.approx([600, 0], abs=1.0)


def test_odometry_that_begins_anew_begins_the_pose_anew() -> None:
    state, _ = along_x(50)
    _, found = update(state, frame_at(NOON_S + 5, planar(-5_000, 70, 2.0), fix_at(50, 0, EAST)))
    assert east_north_m(found) == pytest.approx([50, 0], abs=0.01)
    assert found.pose is not None
    assert found.pose.heading_rad == pytest.approx(EAST)


def test_odometry_that_begins_anew_within_a_street_does_so_too() -> None:
    """A node that was started again: 40 m in a tenth of a second are no car's."""
    state, _ = along_x(41)
    _, found = update(state, frame_at(NOON_S + 4.1, planar(0, 0, 2.0), fix_at(41, 0, EAST)))
    assert east_north_m(found) == pytest.approx([41, 0], abs=0.01)


def test_after_a_gap_of_odometry_the_pose_begins_anew_at_the_next_fix() -> None:
    """Wheels that were silent for two seconds do not know how far the car came."""
    state, _ = along_x(50)
    state, silent = update(state, frame_at(NOON_S + 7.0, planar(55, 0, 0.0), None))
    assert silent == PoseUpdate(None, "no satellite fix yet")
    _, found = update(state, frame_at(NOON_S + 7.1, planar(56, 0, 0.0), fix_at(71, 0, EAST)))
    assert east_north_m(found) == pytest.approx([71, 0], abs=0.01)
