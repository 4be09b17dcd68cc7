"""When an obstacle's size has changed, by the whole rule: both policies, limits, noise, views."""

from __future__ import annotations

import math
from datetime import timedelta

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from contract.observation import Detection
from server.life.policy import COOPERATION, PAPER, Policy
from tests.unit.server.making import HOUR, NOON, Road, detection, kinds, two_passes

policies = pytest.mark.parametrize("policy", [COOPERATION, PAPER], ids=["cooperation", "paper"])
sizes = st.tuples(st.integers(400, 3000), st.integers(400, 3000)).map(lambda pair: (max(pair), min(pair)))


def resized(length_mm: int) -> Detection:
    return detection(length_mm=length_mm, width_mm=700)


@policies
@pytest.mark.parametrize(
    ("change", "length_mm", "decision"),
    [
        ("growth of 14.9 %", 1149, "kept"),
        ("exactly 15 %", 1150, "kept"),
        ("growth of 15.1 %", 1151, "updated"),
        ("shrinkage of 13.0 %", 870, "kept"),
        ("shrinkage of 13.1 %", 869, "updated"),
    ],
)
def test_the_limit_of_fifteen_percent(policy: Policy, change: str, length_mm: int, decision: str) -> None:
    road, decided = two_passes(policy, resized(1000), resized(length_mm))
    assert decided == decision, change
    assert road.only.version == (2 if decision == "updated" else 1)


@policies
@given(st.integers(20, 500), st.integers(20, 500), st.floats(0, math.pi, exclude_max=True))
@settings(max_examples=40, deadline=None)
def test_exactly_fifteen_percent_is_kept_at_every_size(policy: Policy, a: int, b: int, yaw_rad: float) -> None:
    length_mm, width_mm = 20 * max(a, b), 20 * min(a, b)
    before = detection(length_mm=length_mm, width_mm=width_mm, yaw_rad=yaw_rad)
    after = detection(length_mm=length_mm * 115 // 100, width_mm=width_mm, yaw_rad=yaw_rad)
    _, decision = two_passes(policy, before, after)
    assert decision == "kept"


@given(sizes, sizes)
@settings(max_examples=60, deadline=None)
def test_the_paper_policy_updates_exactly_when_a_ratio_exceeds_fifteen_percent(
    old: tuple[int, int], new: tuple[int, int]
) -> None:
    pairs = [(old[0] * old[1], new[0] * new[1]), (old[0], new[0]), (old[1], new[1])]
    beyond = any(100 * max(pair) > 115 * min(pair) for pair in pairs)
    shared = min(old[0], new[0]) * min(old[1], new[1])
    beyond |= 100 * (pairs[0][0] + pairs[0][1] - shared) > 115 * shared
    _, decision = two_passes(PAPER, detection(0, 0, *old), detection(0, 0, *new))
    assert decision == ("updated" if beyond else "kept")


def test_an_update_replaces_the_box_and_counts_a_version() -> None:
    road, decision = two_passes(COOPERATION, detection(), detection(length_mm=1250))
    assert decision == "updated"
    assert (road.only.version, road.only.shape.box.length_mm, road.only.sightings) == (2, 1250, 2)


def test_a_turned_box_is_a_change_and_a_turned_round_one_is_not() -> None:
    turned = two_passes(COOPERATION, detection(width_mm=500, yaw_rad=0.0), detection(width_mm=500, yaw_rad=1.5))
    round_ = two_passes(COOPERATION, detection(width_mm=900, yaw_rad=0.0), detection(width_mm=900, yaw_rad=1.5))
    assert (turned[1], round_[1]) == ("updated", "kept")


def test_a_yaw_just_below_pi_equals_one_just_above_zero() -> None:
    _, decision = two_passes(PAPER, detection(width_mm=400, yaw_rad=0.005), detection(width_mm=400, yaw_rad=-0.005))
    assert decision == "kept"


def test_depth_has_a_limit_of_its_own() -> None:
    deeper = [two_passes(COOPERATION, detection(), detection(relief_mm=relief))[1] for relief in (118, 125, 126)]
    assert deeper == ["kept", "kept", "updated"]


def test_small_changes_below_the_floor_are_none_in_cooperation() -> None:
    before, after = detection(length_mm=300, width_mm=250), detection(length_mm=348, width_mm=250)
    assert two_passes(COOPERATION, before, after)[1] == "kept"
    assert two_passes(PAPER, before, after)[1] == "updated"


def test_an_insignificant_change_waits_for_a_second_pass() -> None:
    road = Road()
    for number in range(3):
        road.sees(f"ego{number}", NOON + number * HOUR, detection(sd=0.05))
    grown = detection(length_mm=1100, width_mm=770, sd=0.05)
    first = road.sees("ego8", NOON + 8 * HOUR, grown)
    second = road.sees("ego9", NOON + 9 * HOUR, grown)
    assert kinds(first + second) == ["kept", "updated"]
    assert first[0].reason == "change-unconfirmed"
    assert (road.only.version, road.only.shape.box.length_mm) == (2, 1100)


def test_a_pending_change_that_is_not_confirmed_is_dropped() -> None:
    road = Road()
    for number in range(3):
        road.sees(f"ego{number}", NOON + number * HOUR, detection(sd=0.05))
    road.sees("ego8", NOON + 8 * HOUR, detection(length_mm=1100, width_mm=770, sd=0.05))
    road.sees("ego9", NOON + 9 * HOUR, detection(sd=0.05))
    assert road.only.pending is None
    assert road.only.version == 1


def test_slow_growth_is_found_since_the_reference_is_frozen() -> None:
    road, decisions = Road(), []
    for day in range(20):
        length_mm = 1000 + 12 * day
        decisions += road.sees(f"ego{day % 4}", NOON + day * 24 * HOUR, detection(length_mm=length_mm))
    assert kinds(decisions).count("updated") == 1


@pytest.mark.parametrize(
    "unsure", [detection(length_mm=1500, sd=0.2), detection(length_mm=1500, front=False, rear=False)]
)
def test_an_uncertain_or_incomplete_size_only_says_seen_again(unsure: Detection) -> None:
    road, decision = two_passes(COOPERATION, detection(), unsure)
    assert (decision, road.only.shape.box.length_mm, road.only.sightings) == ("kept", 1000, 2)


def test_only_equal_views_are_compared() -> None:
    road, decision = two_passes(COOPERATION, detection(), detection(length_mm=800, rear=False))
    assert (decision, road.only.version) == ("kept", 1)
    assert kinds(road.sees("ego3", NOON + 2 * HOUR, detection(length_mm=1000, rear=False))) == ["updated"]


def test_a_box_is_replaced_only_by_a_later_report() -> None:
    road = Road()
    road.sees("ego1", NOON, detection(length_mm=1300))
    late = road.sees("ego2", NOON - HOUR, detection(length_mm=1000))
    assert (kinds(late), late[0].reason) == (["kept"], "earlier-than-the-box")
    assert road.only.shape.box.length_mm == 1300
    assert road.only.first_seen == NOON - HOUR


def test_a_better_look_in_the_first_pass_refines_without_a_new_version() -> None:
    road = Road()
    road.sees("ego1", NOON, detection(length_mm=800, sd=0.08, rear=False))
    decisions = road.sees("ego1", NOON + timedelta(seconds=3), detection(length_mm=1000, sd=0.02))
    assert (kinds(decisions), decisions[0].reason) == (["kept"], "better-look")
    assert (road.only.version, road.only.sightings, road.only.shape.box.length_mm) == (1, 1, 1000)


def test_noise_hardly_ever_updates() -> None:
    """2.5 % noise on each side: of 5 holes and 200 passes each, at most 0.3 % of the passes update."""
    random, updates = np.random.default_rng(20261122), 0
    for _hole in range(5):
        road = Road()
        for number in range(200):
            length_mm, width_mm = (round(mm * math.exp(random.normal(0, 0.025))) for mm in (900, 700))
            yaw_rad = 0.3 + random.normal(0, 0.05)
            seen = detection(
                length_mm=max(length_mm, width_mm), width_mm=min(length_mm, width_mm), sd=0.025, yaw_rad=yaw_rad
            )
            updates += kinds(road.sees(f"ego{number % 7}", NOON + number * HOUR, seen)).count("updated")
    assert updates <= 3


def test_growth_by_a_quarter_is_found_within_two_passes() -> None:
    random, found = np.random.default_rng(7), 0
    for _hole in range(50):
        road = Road()
        for number in range(5):
            growth = 1.25**0.5 if number >= 3 else 1.0
            length_mm, width_mm = (round(growth * mm * math.exp(random.normal(0, 0.02))) for mm in (900, 700))
            road.sees(f"ego{number}", NOON + number * HOUR, detection(0, 0, length_mm, width_mm, sd=0.02))
        found += road.only.version > 1
    assert found >= 48
