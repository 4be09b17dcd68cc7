"""What a report can concern: all that its decisions need, and within what it locks."""

from __future__ import annotations

import math
from uuid import UUID

from hypothesis import given, settings
from hypothesis import strategies as st

from server import rules
from server.geometry.cell_index import CellIndex
from server.geometry.geodesy import offset_from
from server.geometry.quadkey import cell_of, tile_of_cell
from server.life.obstacle import Obstacle
from server.life.policy import COOPERATION
from server.life.reach import Reach, reach_of
from tests.unit.server.making import HOUR, NOON, PATRAS, Road, absent, detection, message

offsets_m = st.tuples(st.floats(-110, 110), st.floats(-50, 50)).filter(lambda offset: math.hypot(*offset) < 120)
pose_sds_m = st.sampled_from((0.1, 0.8, 3.0, 8.0, 20.0))


def _concerned(reach: Reach, obstacles: list[Obstacle]) -> tuple[Obstacle, ...]:
    index = CellIndex((cell_of(item.place.position), item.id) for item in obstacles)
    around = set(index.within(reach.far))
    return tuple(
        item
        for item in obstacles
        if item.id in around and reach.concerns(item.id, item.place.position, item.place.variances_m2)
    )


@given(
    st.lists(st.tuples(offsets_m, pose_sds_m), min_size=1, max_size=12),
    st.lists(offsets_m, min_size=1, max_size=3),
    pose_sds_m,
    st.booleans(),
)
@settings(deadline=None)
def test_a_decision_needs_nothing_beyond_the_reach(
    stored: list[tuple[tuple[float, float], float]],
    seen: list[tuple[float, float]],
    pose_sd_m: float,
    inspects: bool,
) -> None:
    road = Road()
    for number, (hole, sd_m) in enumerate(stored):
        road.sees(f"ego{number}", NOON, detection(*hole), pose_sd_m=sd_m)
    obstacles = sorted(road.obstacles.values(), key=lambda item: item.id)
    inspections = (absent(obstacles[0].id),) if inspects else ()
    sent = message(
        *(detection(*hole) for hole in seen),
        inspections=inspections,
        vehicle="ego",
        at=NOON + HOUR,
        pose_sd_m=pose_sd_m,
    )
    report = rules.Report(sent, sent.observed_at, "key", "ego")
    narrowed = rules.decide(report, _concerned(reach_of(sent, COOPERATION), obstacles), sent.observed_at, COOPERATION)
    assert narrowed == rules.decide(report, tuple(obstacles), sent.observed_at, COOPERATION)


@given(
    st.lists(offsets_m, min_size=1, max_size=3), pose_sds_m, st.floats(0, 3), st.floats(0, 2 * math.pi), st.floats(0, 1)
)
def test_what_a_detection_could_match_is_read_and_locked(
    seen: list[tuple[float, float]], pose_sd_m: float, stored_sd_m: float, azimuth_rad: float, part: float
) -> None:
    reach = reach_of(message(*(detection(*hole) for hole in seen), pose_sd_m=pose_sd_m), COOPERATION)
    gate_m = math.sqrt(COOPERATION.matching.gate_chi_square * (pose_sd_m**2 + 0.05**2 + max(stored_sd_m, 0.3) ** 2))
    east_m, north_m = seen[0]
    away_m = part * gate_m
    there = offset_from(PATRAS, east_m + away_m * math.sin(azimuth_rad), north_m + away_m * math.cos(azimuth_rad))
    cell = cell_of(there)
    assert reach.concerns(UUID(int=1), there, stored_sd_m**2)
    assert tile_of_cell(cell) in reach.tiles
    assert any(low <= cell <= high for low, high in reach.far)
    assert any(low <= cell <= high for low, high in reach.near_cells)


def test_without_a_detection_nothing_is_near() -> None:
    reach = reach_of(message(), COOPERATION)
    assert (reach.near, reach.near_cells) == (None, ())
    assert not reach.concerns(UUID(int=1), PATRAS, 0.5)
