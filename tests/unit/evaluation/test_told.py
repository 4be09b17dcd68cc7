"""What whole drives would tell: which sweeps are dropped, and a recorded sound road of which nothing is told."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluation.told import LONGEST_BURST, dropped, recorded, sweeps_and_car

DATA = Path(os.environ.get("HEADSUP_DATA", Path(__file__).parents[4] / "shared" / "data"))


@given(st.integers(0, 2**32), st.integers(1, 500), st.floats(0.0, 0.9))
def test_a_share_of_the_sweeps_is_dropped_and_hardly_more(seed: int, sweeps: int, share: float) -> None:
    gone = dropped(np.random.default_rng(seed), sweeps, share)
    assert share * sweeps <= gone.sum() < math.ceil(share * sweeps) + LONGEST_BURST
    assert np.array_equal(gone, dropped(np.random.default_rng(seed), sweeps, share))


def test_sweeps_are_dropped_alone_and_in_short_bursts() -> None:
    gone = dropped(np.random.default_rng(1), 10_000, 0.02)
    runs = [len(run) for run in "".join("x" if g else " " for g in gone).split()]
    assert set(range(1, LONGEST_BURST + 1)) <= set(runs)


@pytest.mark.realdata
@pytest.mark.parametrize("first", [7, 119])
def test_a_drive_along_a_sound_road_tells_nothing_wherever_it_begins(first: int) -> None:
    """From these places a hole of a tree beside the road, and what lies behind the first sweep, were believed."""
    folder = DATA / "kitti_drive"
    if not folder.is_dir():
        pytest.skip(f"no {folder}: set HEADSUP_DATA")
    frames, car = sweeps_and_car(folder)
    (drive,) = recorded(frames[first : first + 60], car, seeds=[0], share=0.0)
    assert drive.told == ()
