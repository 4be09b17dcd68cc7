"""The figures by which simulated and real sensors are compared, and that they agree where they should."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from headsup.simulate.sensors_command import sensors
from simulator.sensors.lidar_presets import LIDAR_PRESETS, hdl32e, hdl64e
from simulator.sensors.sensor_comparison import (
    DISTANCES_M,
    ComparisonError,
    Figures,
    Scan,
    figures,
    read_kitti,
    read_nuscenes,
    simulated,
)
from simulator.sensors.sensor_table import Comparison, as_json, compare, markdown
from simulator.world import World

DATA = Path(os.environ.get("HEADSUP_DATA", Path(__file__).parents[5] / "shared/data"))
app = typer.Typer()
app.command()(sensors)


@pytest.fixture(scope="module")
def of_hdl64(world: World) -> tuple[list[Scan], Figures]:
    scans = simulated(world, hdl64e(), 2, seed=1)
    return scans, figures(scans)


def write_kitti(path: Path, scan: Scan) -> None:
    """As KITTI does: rings from above, each beginning ahead and going to the left."""
    azimuth = np.arctan2(scan.points_m[:, 1], scan.points_m[:, 0]) % (2 * np.pi)
    order = np.lexsort((azimuth, -scan.ring))
    np.column_stack([scan.points_m, scan.intensity])[order].astype(np.float32).tofile(path)


def write_nuscenes(path: Path, scan: Scan, shift_m: float) -> None:
    """Every ray, moved to the turn's end: x right, y ahead; rays without return at the sensor."""
    azimuth = np.arctan2(scan.points_m[:, 1], scan.points_m[:, 0])
    column = np.clip(((np.pi - azimuth) / (2 * np.pi) * 1084).astype(int), 0, 1083)
    rows = np.zeros((1084, 32, 5))
    rows[:, :, 4] = np.arange(32)
    rows[column, scan.ring, 0] = -scan.points_m[:, 1]
    rows[column, scan.ring, 1] = scan.points_m[:, 0]
    rows[column, scan.ring, 2] = scan.points_m[:, 2]
    rows[:, :, 1] += np.linspace(-shift_m, 0, 1084)[:, None]
    rows.reshape(-1, 5).astype(np.float32).tofile(path)


def test_figures_find_the_sensor_that_made_the_scans(of_hdl64: tuple[list[Scan], Figures]) -> None:
    lidar, (_, found) = hdl64e(), of_hdl64
    assert found.columns == pytest.approx(lidar.columns, abs=1)
    assert found.elevations_deg == pytest.approx(np.degrees(lidar.elevations_rad), abs=0.1)
    assert found.ring_heights_m == pytest.approx(lidar.heights_m, abs=0.02)
    assert found.road_noise_m == pytest.approx(lidar.range_sd_m, rel=0.15)
    assert found.sensor_height_m == pytest.approx(1.73, abs=0.06)  # the crown lies higher than the lane
    assert found.points_per_ring.sum() == pytest.approx(found.points)
    assert 0 < found.missing_share < 0.2


def test_density_falls_with_distance_and_noise_is_told_from_the_road(world: World) -> None:
    noisy = figures(simulated(world, replace(hdl32e(), range_sd_m=0.02), 2, seed=2))
    assert (np.diff(noisy.road_density) <= 0).all()
    assert len(noisy.road_density) == len(DISTANCES_M) - 1
    assert noisy.road_noise_m == pytest.approx(0.02, rel=0.15)


def test_a_scan_in_kittis_form_reads_back_with_its_rings(tmp_path: Path, of_hdl64: tuple[list[Scan], Figures]) -> None:
    scan = of_hdl64[0][0]
    write_kitti(tmp_path / "0.bin", scan)
    back = read_kitti(tmp_path / "0.bin")
    assert back.channels == 64
    assert np.bincount(back.ring).tolist() == np.bincount(scan.ring).tolist()
    for ring in (0, 31, 63):
        ours, theirs = scan.points_m[scan.ring == ring], back.points_m[back.ring == ring]
        assert np.sort(theirs[:, 0]) == pytest.approx(np.sort(ours[:, 0]), abs=1e-5)


def test_a_sweep_in_nuscenes_form_reads_back_without_the_shift_of_its_own_motion(tmp_path: Path, world: World) -> None:
    scan = simulated(world, hdl32e(), 1, seed=3)[0]
    write_nuscenes(tmp_path / "0.pcd.bin", scan, shift_m=0.45)
    back = read_nuscenes(tmp_path / "0.pcd.bin")
    assert len(back.points_m) == pytest.approx(len(scan.points_m), rel=0.02)
    elevation = np.arctan2(back.points_m[:, 2], np.hypot(back.points_m[:, 0], back.points_m[:, 1]))
    assert elevation == pytest.approx(hdl32e().elevations_rad[back.ring], abs=0.002)


@pytest.mark.parametrize("content", [b"", b"123", np.full(8, np.nan, dtype=np.float32).tobytes(), bytes(160)])
def test_a_damaged_scan_is_an_error_that_names_it(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "bad.bin").write_bytes(content)
    for read in (read_kitti, read_nuscenes):
        with pytest.raises(ComparisonError, match=r"bad\.bin"):
            read(tmp_path / "bad.bin")


def test_the_table_and_its_json_hold_every_figure(of_hdl64: tuple[list[Scan], Figures]) -> None:
    comparison = Comparison("hdl64", "itself", 2, of_hdl64[1], of_hdl64[1])
    lines = markdown(comparison).splitlines()
    assert all(line.count("|") == 4 for line in lines)
    for line in lines[2:]:
        if "difference" not in line:
            _, _, real, ours, _ = line.split("|")
            assert real == ours
    record = json.loads(as_json([comparison]))[0]
    assert set(record["real"]) == set(Figures.__slots__)
    assert record["real"] == record["simulated"]


def test_the_command_says_in_one_line_what_is_missing(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["--data", str(tmp_path)])
    assert result.exit_code == 1
    assert "has no kitti_sequence/velodyne/*.bin" in result.stderr


@pytest.mark.realdata
@pytest.mark.skipif(not (DATA / "kitti_sequence").is_dir(), reason="no recorded data here (HEADSUP_DATA)")
def test_presets_agree_with_real_scans_where_the_sensor_and_not_the_street_decides(world: World) -> None:
    for one in compare(DATA, world, seed=1):
        real, ours = one.real, one.simulated
        assert ours.columns == pytest.approx(real.columns, rel=0.005)
        off_deg = np.abs(ours.elevations_deg - real.elevations_deg)
        assert np.median(off_deg) < 0.06
        assert ours.road_noise_m == pytest.approx(real.road_noise_m, rel=0.2)
        assert ours.road_density[:2] == pytest.approx(real.road_density[:2], rel=0.12)
        assert ours.road_density[2:] == pytest.approx(real.road_density[2:], rel=0.5, abs=0.5)
        assert ours.road_intensity[1] == pytest.approx(real.road_intensity[1], rel=0.6)
        assert len(LIDAR_PRESETS[one.preset]().elevations_rad) == len(real.elevations_deg)
