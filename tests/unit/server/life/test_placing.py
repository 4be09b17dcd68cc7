"""Where an obstacle is: refined by better looks, kept by worse ones, confirmed by those that know the place."""

from __future__ import annotations

import math

import pytest

from contract.geometry import LatLon
from contract.observation import State
from server.geometry.geodesy import offset_from
from server.life.policy import COOPERATION
from tests.unit.server.making import HOUR, NOON, PATRAS, Road, detection


def test_the_refined_position_stays_near_the_first_that_was_well_known() -> None:
    road = Road()
    for number in range(60):
        east_m = 10.0 + 0.6 * number
        road.sees(f"ego{number}", NOON + number * HOUR, detection(east_m), pose_sd_m=2.0)
        first = next(iter(road.obstacles.values()))
    assert math.hypot(*_apart_m(first.born_at, first.place.position)) <= COOPERATION.matching.greatest_drift_m


def _apart_m(a: LatLon, b: LatLon) -> tuple[float, float]:
    north_m = (a.latitude_deg - b.latitude_deg) * 111_000
    return north_m, (a.longitude_deg - b.longitude_deg) * 111_320 * math.cos(math.radians(a.latitude_deg))


@pytest.mark.parametrize("apart_m", [5.0, 18.0, 22.0, 30.0])
def test_a_coarse_first_sighting_moves_to_where_better_ones_are(apart_m: float) -> None:
    road = Road()
    road.sees("ego1", NOON, detection(0), pose_sd_m=10.0)
    for number in range(2, 5):
        road.sees(f"ego{number}", NOON + number * HOUR, detection(apart_m), pose_sd_m=0.2)
    place = offset_from(PATRAS, apart_m, 5.0)
    assert math.hypot(*_apart_m(road.only.place.position, place)) < 0.5


def test_a_look_from_nobody_knows_where_confirms_nothing() -> None:
    road = Road()
    road.sees("ego1", NOON, detection(0), pose_sd_m=0.2)
    road.sees("ego2", NOON + HOUR, detection(40), pose_sd_m=19.0)
    assert (road.only.state, road.only.witness_count) == (State.CANDIDATE, 2)
    road.sees("ego3", NOON + 2 * HOUR, detection(0.1), pose_sd_m=0.5)
    assert road.only.state is State.CONFIRMED
