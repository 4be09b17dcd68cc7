from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.shapes.pothole import PotholeShape
from simulator.shapes.relief import GRAVEL_SD_M, GRID_STEP_M, Material, Relief

SEEDS = st.integers(0, 10_000)
SHARES = st.floats(0.05, 0.95)


def bowl(depth_m: float = 0.10, size: int = 41) -> Relief:
    """A paraboloid of revolution, 0.4 m across, whose volume is known: half of its cylinder."""
    axis = (np.arange(size) - size // 2) * GRID_STEP_M
    x, y = np.meshgrid(axis, axis)
    rho2 = (x**2 + y**2) / 0.2**2
    return Relief(np.where(rho2 < 1, -depth_m * (1 - rho2), 0.0), rho2 < 1, GRID_STEP_M)


def test_sizes_area_and_volume_of_a_bowl_are_those_of_geometry() -> None:
    hole = bowl()
    assert (hole.length_m, hole.width_m) == pytest.approx((0.4, 0.4), abs=1.01 * GRID_STEP_M)
    assert hole.relief_m == pytest.approx(0.10)
    assert hole.footprint_area_m2 == pytest.approx(math.pi * 0.2**2, rel=0.01)
    assert hole.volume_m3 == pytest.approx(math.pi * 0.2**2 * 0.10 / 2, rel=0.01)


@settings(max_examples=20, deadline=None)
@given(SEEDS, SHARES)
def test_standing_water_is_level_for_a_ray_and_the_truth_stays_deep(seed: int, water: float) -> None:
    dry = PotholeShape(0.9, 0.7, 0.10).relief(seed)
    wet = dry.flooded(water)
    assert wet.materials is not None
    under = wet.materials == Material.WATER
    assert np.ptp(wet.heights_m[under]) == 0
    assert wet.heights_m[under][0] == pytest.approx(-0.10 * (1 - water))
    assert (wet.heights_m[~under] == dry.heights_m[~under]).all()
    assert (wet.relief_m, wet.volume_m3) == (dry.relief_m, dry.volume_m3)
    assert (wet.length_m, wet.width_m) == (dry.length_m, dry.width_m)
    assert wet.footprint_area_m2 == dry.footprint_area_m2


@settings(max_examples=20, deadline=None)
@given(SEEDS, st.floats(-50, 200), st.sampled_from([0.0, 0.6]))
def test_wear_enlarges_area_and_depth_by_the_same_share(seed: int, percent: float, water: float) -> None:
    young = PotholeShape(0.8, 0.6, 0.08, water=water).relief(seed)
    old = young.aged(percent)
    factor = 1 + percent / 100
    assert old.footprint_area_m2 == pytest.approx(factor * young.footprint_area_m2)
    assert old.relief_m == pytest.approx(factor * young.relief_m)
    assert old.volume_m3 == pytest.approx(factor**2 * young.volume_m3)
    assert old.length_m == pytest.approx(math.sqrt(factor) * young.length_m)
    assert old.width_m == pytest.approx(math.sqrt(factor) * young.width_m)


@settings(max_examples=20, deadline=None)
@given(SEEDS, SHARES)
def test_gravel_leaves_the_part_of_the_depth_above_it(seed: int, fraction: float) -> None:
    hole = PotholeShape(0.9, 0.7, 0.12).relief(seed)
    filled = hole.filled(fraction, seed)
    assert filled.relief_m == pytest.approx(0.12 * (1 - fraction), abs=2 * GRAVEL_SD_M + 1e-9)
    assert filled.volume_m3 < hole.volume_m3
    assert filled.footprint is hole.footprint
    assert filled.materials is not None
    gravel = filled.materials == Material.GRAVEL
    assert (filled.heights_m[~gravel] == hole.heights_m[~gravel]).all()


def test_gravel_in_a_puddle_displaces_the_water_above_which_it_stands() -> None:
    puddle = bowl().flooded(0.5)
    low, high = puddle.filled(0.2, 1), puddle.filled(0.9, 1)
    assert low.materials is not None
    assert high.materials is not None
    assert (low.materials == Material.WATER).any()
    assert low.heights_m[low.materials == Material.WATER] == pytest.approx(-0.05)
    assert low.relief_m == pytest.approx(0.08, abs=2 * GRAVEL_SD_M + 1e-9)
    assert not (high.materials == Material.WATER).any()


def test_the_same_seed_gives_the_same_gravel() -> None:
    one, again, other = (bowl().filled(0.5, seed).heights_m.tobytes() for seed in (1, 1, 2))
    assert one == again
    assert one != other


@pytest.mark.parametrize("fraction", [-0.1, 1.1, math.nan])
def test_a_hole_cannot_be_filled_to_less_than_nothing_or_more_than_the_road(fraction: float) -> None:
    with pytest.raises(ValueError, match="between 0 and 1"):
        bowl().filled(fraction)


@pytest.mark.parametrize("percent", [-100.0, -51.0, 1e6, math.nan, math.inf])
def test_growth_that_leaves_nothing_or_no_road_is_refused(percent: float) -> None:
    with pytest.raises(ValueError, match="growth is -50 to 300 %"):
        bowl().aged(percent)


def test_only_a_hole_can_be_filled() -> None:
    rise = Relief(-bowl().heights_m, bowl().footprint, GRID_STEP_M)
    assert not rise.is_hole
    with pytest.raises(ValueError, match="only a hole"):
        rise.filled(0.5)


def test_grids_that_do_not_fit_together_are_refused() -> None:
    hole = bowl()
    with pytest.raises(ValueError, match="one shape"):
        Relief(hole.heights_m, hole.footprint[:-1], GRID_STEP_M)
    with pytest.raises(ValueError, match="finite"):
        Relief(np.where(hole.footprint, math.nan, 0.0), hole.footprint, GRID_STEP_M)
    with pytest.raises(ValueError, match="step must be positive"):
        Relief(hole.heights_m, hole.footprint, 0.0)
    with pytest.raises(ValueError, match="covers nothing"):
        Relief(hole.heights_m, np.zeros_like(hole.footprint), GRID_STEP_M)


@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_a_place_is_covered_where_it_is_lower_than_the_road(x: float, y: float) -> None:
    hole = bowl()
    at = np.array([x]), np.array([y])
    radius = math.hypot(x, y)
    # Between cells the height is bilinear: the edge is blurred over a cell's diagonal.
    if abs(radius - 0.2) > math.sqrt(2) * GRID_STEP_M:
        assert bool(hole.covers(*at)[0]) == (radius < 0.2)
        assert (hole.height_at(*at)[0] < 0) == (radius < 0.2)
        assert hole.material_at(*at)[0] == (Material.BROKEN if radius < 0.2 else Material.ASPHALT)
