"""The map laid on what the car sees: one shift for all, and none where it would be a guess."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contract.geometry import Kind
from contract.obstacle import ObstacleFeature
from detector.types import ObstacleKind
from tests.unit.vehicle_client.making import feature, planar, pose_at, track_at
from vehicle_client.alignment import ALIGNED_SD_M, GATE_M, Alignment, align
from vehicle_client.frames import apply, inverse
from vehicle_client.tracking import Track

PLACES = ((5.0, 0.0), (14.0, 2.0), (26.0, -1.0))


def features_at(*places_m: tuple[float, float], kind: Kind = Kind.POTHOLE) -> list[ObstacleFeature]:
    return [feature(n, east_m=x, north_m=y, kind=kind) for n, (x, y) in enumerate(places_m, start=1)]


def tracks_at(*places_m: tuple[float, float], kind: ObstacleKind = ObstacleKind.POTHOLE) -> list[Track]:
    return [track_at(x, y, n, kind=kind) for n, (x, y) in enumerate(places_m, start=1)]


@settings(max_examples=40, deadline=None)
@given(st.floats(-2.5, 2.5), st.floats(-2.5, 2.5), st.floats(-3, 3))
def test_the_shift_of_several_places_is_found_in_any_odometry(east_m: float, north_m: float, yaw_rad: float) -> None:
    pose = pose_at(odom_from_vehicle=planar(40.0, -7.0, yaw_rad))
    odom_from_enu = inverse(pose.enu_from_odom)
    seen = [apply(odom_from_enu, np.array([x + east_m, y + north_m, 0.0]))[:2] for x, y in PLACES]
    found = align(features_at(*PLACES), tracks_at(*((float(x), float(y)) for x, y in seen)), pose)
    assert found.pairs == 3
    assert odom_from_enu[:2, :2].T @ found.shift_m == pytest.approx([east_m, north_m], abs=0.01)


def test_a_place_that_does_not_agree_is_left_out() -> None:
    seen = [(x + 1.0, y + 0.5) for x, y in PLACES[:2]] + [(PLACES[2][0] - 2.0, PLACES[2][1])]
    found = align(features_at(*PLACES), tracks_at(*seen), pose_at())
    assert found.pairs == 2
    assert found.shift_m == pytest.approx([1.0, 0.5], abs=0.01)


@pytest.mark.parametrize(
    "tracks",
    [
        [],
        tracks_at((5.0 + GATE_M + 0.1, 0.0)),
        tracks_at((5.0, 0.0), kind=ObstacleKind.BUMP),
        [track_at(5.0, 0.0, sightings=1)],
    ],
    ids=["nothing", "far", "other sign", "not believed"],
)
def test_without_a_believed_track_of_the_sign_nearby_nothing_is_shifted(tracks: list[Track]) -> None:
    found = align(features_at((5.0, 0.0)), tracks, pose_at())
    assert (found.pairs, found.shift_m.tolist()) == (0, [0, 0])
    assert align([], tracks, pose_at()).pairs == 0


def test_of_two_shifts_that_explain_as_much_none_is_taken() -> None:
    assert align(features_at((10.0, 0.0)), tracks_at((8.0, 0.0), (12.5, 0.0)), pose_at()).pairs == 0


def test_an_aligned_place_is_surer_than_one_that_is_not() -> None:
    assert Alignment().place_sd_m(0.5, 1.2) == pytest.approx(1.3)
    assert Alignment(pairs=2).place_sd_m(0.5, 1.2) == ALIGNED_SD_M
    assert Alignment(pairs=2).place_sd_m(0.1, 0.1) < ALIGNED_SD_M
