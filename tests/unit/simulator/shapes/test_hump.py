from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.shapes.hump import SIDE_TAPER_M, HumpProfile, bump, speed_hump
from simulator.shapes.relief import GRID_STEP_M, Material

PROFILES = st.sampled_from(HumpProfile)


def section(profile: HumpProfile, length_m: float = 3.7, height_m: float = 0.075) -> np.ndarray:
    """Heights along the middle of a hump."""
    hump = speed_hump(profile, length_m, 3.4, height_m)
    return hump.heights_m[hump.heights_m.shape[0] // 2]


@settings(max_examples=20, deadline=None)
@given(PROFILES, st.floats(0.9, 6.0), st.floats(0.8, 7.0), st.floats(0.025, 0.100))
def test_a_hump_has_the_sizes_that_were_asked_for(
    profile: HumpProfile, length: float, width: float, height: float
) -> None:
    hump = speed_hump(profile, length, width, height)
    assert hump.length_m == pytest.approx(length, abs=2.01 * GRID_STEP_M)
    assert hump.width_m == pytest.approx(width, abs=2.01 * GRID_STEP_M)
    assert hump.relief_m == pytest.approx(height, rel=0.01)
    assert hump.heights_m.min() >= 0
    assert not hump.is_hole


@pytest.mark.parametrize("profile", HumpProfile)
def test_a_hump_rises_to_its_middle_and_falls_evenly(profile: HumpProfile) -> None:
    heights = section(profile)
    assert heights == pytest.approx(heights[::-1])
    rising = heights[: len(heights) // 2 + 1]
    assert (np.diff(rising) >= -1e-12).all()


def test_profiles_hold_the_share_of_their_box_that_geometry_says() -> None:
    shares = {profile: section(profile).mean() / 0.075 for profile in HumpProfile}
    # Mean of a raised cosine; of a shallow circular segment; a plateau with two ramps of 1 in 12.
    assert shares[HumpProfile.SINUSOIDAL] == pytest.approx(1 / 2, abs=0.01)
    assert shares[HumpProfile.ROUND_TOP] == pytest.approx(2 / 3, abs=0.01)
    assert shares[HumpProfile.FLAT_TOP] == pytest.approx(1 - 12 * 0.075 / 3.7, abs=0.01)


def test_a_round_top_is_an_arc_of_a_circle() -> None:
    heights = section(HumpProfile.ROUND_TOP)
    x = (np.arange(len(heights)) - len(heights) // 2) * GRID_STEP_M
    radius = (3.7**2 / 4 + 0.075**2) / (2 * 0.075)
    on = heights > 0
    assert np.hypot(x[on], heights[on] + radius - 0.075) == pytest.approx(radius)


def test_a_hump_ends_in_tapers_at_its_sides() -> None:
    hump = speed_hump(HumpProfile.FLAT_TOP, 3.7, 3.4, 0.075)
    across = hump.heights_m[:, hump.heights_m.shape[1] // 2]
    plateau = np.count_nonzero(np.isclose(across, 0.075)) * GRID_STEP_M
    assert plateau == pytest.approx(3.4 - 2 * SIDE_TAPER_M, abs=0.03)
    assert across[[0, -1]].tolist() == [0, 0]


def test_only_the_near_ramp_is_marked() -> None:
    hump = speed_hump(HumpProfile.SINUSOIDAL, 3.7, 3.4, 0.075)
    assert hump.materials is not None
    columns = np.flatnonzero((hump.materials == Material.MARK).any(axis=0))
    assert columns.size > 0
    assert columns.max() < hump.materials.shape[1] / 2
    assert (hump.materials[~hump.footprint] == Material.ASPHALT).all()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.3, 2.0), st.floats(0.3, 1.5), st.floats(0.02, 0.15))
def test_a_bump_has_the_sizes_that_were_asked_for(seed: int, length: float, width: float, height: float) -> None:
    rise = bump(seed, length, width, height)
    assert rise.length_m == pytest.approx(length, abs=2.01 * GRID_STEP_M)
    assert rise.width_m == pytest.approx(width, abs=2.01 * GRID_STEP_M)
    assert rise.relief_m == pytest.approx(height)
    assert (rise.heights_m[~rise.footprint] == 0).all()


@pytest.mark.parametrize(
    ("length", "width", "height", "message"),
    [
        (3.7, 3.4, 0.02, "0.025 to 0.1 m high"),
        (3.7, 3.4, 0.11, "0.025 to 0.1 m high"),
        (0.8, 3.4, 0.075, "0.9 to 20 m long"),
        (math.nan, 3.4, 0.075, "0.9 to 20 m long"),
        (3.7, 0.6, 0.075, "between 0.6 and 10 m wide"),
        (3.7, 10.5, 0.075, "between 0.6 and 10 m wide"),
        (3.7, math.nan, 0.075, "between 0.6 and 10 m wide"),
    ],
)
def test_a_hump_against_the_regulations_is_refused(length: float, width: float, height: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        speed_hump(HumpProfile.ROUND_TOP, length, width, height)


@pytest.mark.parametrize("sizes", [(0.0, 0.5, 0.1), (0.5, -1.0, 0.1), (0.5, 0.5, math.nan), (30.0, 0.5, 0.1)])
def test_a_bump_of_an_impossible_size_is_refused(sizes: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match="of a bump must be between"):
        bump(1, *sizes)
