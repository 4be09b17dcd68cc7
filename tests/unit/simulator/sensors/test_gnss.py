"""Fixes: their statistics are those of the model's formulas, and of a real receiver."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import pymap3d
import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.geometry import LatLon
from simulator.mesh import pose
from simulator.sensors.gnss import CarlaGnss, GnssError, GnssModel, GnssReceiver, metres_per_degree
from simulator.streets.street import GeoReference

DATA = Path(os.environ.get("HEADSUP_DATA", Path(__file__).parents[5] / "shared/data"))
HERE = GeoReference(LatLon(latitude_deg=38.2466, longitude_deg=21.7346), altitude_m=60.0)
ENU_FROM_STREET = pose(12.0, -7.5, 0.4, yaw_rad=0.6)
ANTENNA = pose(40.0, -1.75, 1.5)
TRUE_ENU_M = (ENU_FROM_STREET @ ANTENNA[:, 3])[:3]


def errors(model: GnssError, times_s: np.ndarray, seed: int) -> np.ndarray:
    """Errors (N, 3) east, north, up; NaN where there was no fix."""
    receiver = GnssReceiver(model, HERE, ENU_FROM_STREET, np.random.default_rng(seed))
    fixes = [receiver.measure(ANTENNA, float(time)) for time in times_s]
    found = [
        (fix.position.latitude_deg, fix.position.longitude_deg, fix.altitude_m) if fix else 3 * (np.nan,)
        for fix in fixes
    ]
    origin = HERE.position.latitude_deg, HERE.position.longitude_deg, HERE.altitude_m
    return np.stack(pymap3d.geodetic2enu(*np.array(found).T, *origin), axis=1) - TRUE_ENU_M


def test_a_receiver_without_errors_gives_the_place_of_the_antenna() -> None:
    exact = GnssModel(bias_sd_m=(0, 0, 0), noise_sd_m=(0, 0, 0))
    assert errors(exact, np.arange(5.0), 0) == pytest.approx(np.zeros((5, 3)), abs=1e-6)


def test_many_receivers_spread_as_the_model_states() -> None:
    model = GnssModel()
    first = np.concatenate([errors(model, np.array([7.0]), seed) for seed in range(2000)])
    # The standard error of a standard deviation from 2000 draws is 1.6 %.
    assert first.std(axis=0) == pytest.approx(model.total_sd_m, rel=0.07)
    assert np.abs(first.mean(axis=0)).max() < 4 * 2.0 / math.sqrt(2000)
    stated = GnssReceiver(model, HERE, ENU_FROM_STREET, np.random.default_rng(0)).measure(ANTENNA, 0.0)
    assert stated is not None
    assert (stated.sd_m, stated.altitude_sd_m) == pytest.approx((model.total_sd_m[0], model.total_sd_m[2]))


def test_the_bias_is_forgotten_exponentially() -> None:
    model = GnssModel(bias_sd_m=(1, 2, 3), bias_time_s=20.0, noise_sd_m=(0, 0, 0))
    error = errors(model, np.arange(8_000) * 5.0, 1) / model.bias_sd_m
    for lag in (1, 4, 12):
        kept = (error[lag:] * error[:-lag]).mean()
        assert kept == pytest.approx(math.exp(-lag * 5 / 20), abs=0.07)


def test_noise_is_white_and_comes_on_top_of_the_bias() -> None:
    model = GnssModel(bias_sd_m=(0, 0, 0), noise_sd_m=(0.3, 0.3, 0.6), offset_m=(1.0, -2.0, 5.0))
    error = errors(model, np.arange(4_000) * 0.1, 2)
    assert error.std(axis=0) == pytest.approx(model.noise_sd_m, rel=0.05)
    assert error.mean(axis=0) == pytest.approx(model.offset_m, abs=0.04)
    centred = (error - error.mean(axis=0)) / error.std(axis=0)
    assert np.abs((centred[1:] * centred[:-1]).mean(axis=0)).max() < 0.07


def test_the_rate_does_not_change_how_far_the_bias_wanders() -> None:
    model = GnssModel(bias_sd_m=(1, 1, 1), bias_time_s=10.0, noise_sd_m=(0, 0, 0))
    moved = [
        np.concatenate(
            [
                errors(model, np.linspace(0, 5, steps), seed)[[-1]] - errors(model, np.array([0.0]), seed)
                for seed in range(300)
            ]
        )
        for steps in (2, 21)
    ]
    assert np.std(moved[0]) == pytest.approx(np.std(moved[1]), rel=0.1)


def test_outages_take_the_stated_share_of_the_time() -> None:
    model = GnssModel(outage_every_s=300.0, outage_lasts_s=100.0)
    missing = np.isnan(errors(model, np.arange(0, 100_000, 10.0), 3)[:, 0])
    assert missing.mean() == pytest.approx(100 / 400, abs=0.04)
    starts = np.count_nonzero(np.diff(missing.astype(int)) == 1)
    assert starts == pytest.approx(100_000 / 400, rel=0.2)


def test_the_same_seed_gives_the_same_fixes_and_another_seed_others() -> None:
    times = np.arange(10.0)
    assert np.array_equal(errors(GnssModel(), times, 5), errors(GnssModel(), times, 5))
    assert not np.array_equal(errors(GnssModel(), times, 5), errors(GnssModel(), times, 6))


def test_time_does_not_run_backwards() -> None:
    receiver = GnssReceiver(GnssModel(), HERE, ENU_FROM_STREET, np.random.default_rng(0))
    receiver.measure(ANTENNA, 3.0)
    with pytest.raises(ValueError, match="cannot follow"):
        receiver.measure(ANTENNA, 3.0)


@pytest.mark.parametrize("fields", [{"bias_sd_m": (-1, 0, 0)}, {"noise_sd_m": (math.nan, 0, 0)}, {"bias_time_s": 0.0}])
def test_impossible_receivers_are_refused(fields: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="receiver"):
        GnssModel(**fields)  # type: ignore[arg-type]


@given(st.floats(-85, 85), st.floats(-179, 179))
def test_a_degree_is_as_long_as_on_the_ellipsoid(latitude: float, longitude: float) -> None:
    east, north = metres_per_degree(latitude)
    small = 1e-5
    moved = pymap3d.geodetic2enu(latitude + small, longitude + small, 0, latitude, longitude, 0)
    assert moved[:2] == pytest.approx((east * small, north * small), rel=1e-4)


def test_carlas_degrees_become_metres_where_the_receiver_is() -> None:
    carla = CarlaGnss(latitude_sd_deg=1e-5, longitude_sd_deg=2e-5, altitude_sd_m=0.7, latitude_bias_deg=5e-5)
    error = errors(carla, np.arange(3_000) * 0.1, 4)
    east, north = metres_per_degree(38.2466)
    assert error.std(axis=0) == pytest.approx([2e-5 * east, 1e-5 * north, 0.7], rel=0.06)
    assert error.mean(axis=0) == pytest.approx([0, 5e-5 * north, 0], abs=0.15)


@pytest.mark.realdata
@pytest.mark.skipif(not (DATA / "drive_comma").is_dir(), reason="no recorded data here (HEADSUP_DATA)")
def test_a_minute_of_the_model_is_like_a_minute_of_a_real_receiver() -> None:
    real = _real_errors(DATA / "drive_comma/drive.npz")
    model = [errors(GnssModel(), np.arange(579) * 0.1, seed) for seed in range(24)]
    off = [float(np.median(np.hypot(error[:, 0], error[:, 1]))) for error in model]
    assert np.quantile(off, 0.1) < np.median(np.hypot(real[:, 0], real[:, 1])) < np.quantile(off, 0.9)
    for lag in (50, 200):  # 5 and 20 s
        moved = [_wander(error, lag) for error in model]
        assert min(moved) < _wander(real, lag) < max(moved)


def _wander(error: np.ndarray, lag: int) -> float:
    return float(np.sqrt(np.square(error[lag:, :2] - error[:-lag, :2]).mean()))


def _real_errors(path: Path) -> np.ndarray:
    drive = np.load(path)
    true = np.stack([np.interp(drive["gnss_t"], drive["frame_times"], axis) for axis in drive["positions_ecef"].T])
    latitude, longitude, altitude = pymap3d.ecef2geodetic(*true)
    fix = drive["gnss"]
    return np.stack(pymap3d.geodetic2enu(fix[:, 0], fix[:, 1], fix[:, 4], latitude, longitude, altitude), axis=1)
