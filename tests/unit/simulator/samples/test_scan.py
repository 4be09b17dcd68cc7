from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.samples.scan import DEEPEST_M, SHALLOWEST_M, ScanError, find_scans, load_scan, load_scan_true
from simulator.samples.scan import write_mould as write_mould_of
from simulator.shapes.hump import bump
from simulator.shapes.pothole import GRID_STEP_M, PotholeShape

DATA = Path(os.environ.get("HEADSUP_DATA", "../shared/data"))


def write_mould(path: Path, length_mm: float = 80, width_mm: float = 60, height_mm: float = 30) -> bytes:
    """A convex mould: half an ellipsoid, long axis along y, as binary PLY."""
    rng = np.random.default_rng(0)
    u, v = rng.uniform(-1, 1, (2, 60_000))
    inside = u**2 + v**2 < 1
    u, v = u[inside], v[inside]
    points = np.stack([u * width_mm / 2, v * length_mm / 2, height_mm * np.sqrt(1 - u**2 - v**2)], axis=1)
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    header += "property float x\nproperty float y\nproperty float z\nend_header\n"
    data = header.encode() + points.astype("<f4").tobytes()
    path.write_bytes(data)
    return data


def test_a_mould_becomes_a_hole_of_the_length_asked_for_with_its_proportions(tmp_path: Path) -> None:
    write_mould(tmp_path / "mould.ply")
    hole = load_scan(tmp_path / "mould.ply", length_m=0.9, depth_m=0.1)
    assert hole.length_m == pytest.approx(0.9, abs=3 * GRID_STEP_M)
    assert hole.width_m == pytest.approx(0.9 * 60 / 80, abs=3 * GRID_STEP_M)
    assert hole.relief_m == pytest.approx(0.1)
    assert hole.heights_m.max() == 0
    rows, columns = hole.heights_m.shape
    assert hole.heights_m[rows // 2, columns // 2] < -0.095
    for edge in (hole.heights_m[0], hole.heights_m[-1], hole.heights_m[:, 0], hole.heights_m[:, -1]):
        assert (edge == 0).all()


def test_without_a_depth_it_is_that_of_a_road_pothole(tmp_path: Path) -> None:
    write_mould(tmp_path / "mould.ply")
    assert SHALLOWEST_M <= load_scan(tmp_path / "mould.ply").relief_m <= DEEPEST_M


def test_a_folder_without_scans_is_a_clear_error(tmp_path: Path) -> None:
    with pytest.raises(ScanError, match="no pothole scans"):
        find_scans(tmp_path)


@pytest.mark.parametrize("content", [b"", b"not a scan", b"ply\nformat ascii 1.0\nend_header\n", b"\x00\xff" * 500])
def test_a_file_that_is_no_scan_is_a_clear_error(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "bad.ply").write_bytes(content)
    with pytest.raises(ScanError, match=r"bad\.ply"):
        load_scan(tmp_path / "bad.ply")


def test_a_truncated_scan_is_a_clear_error(tmp_path: Path) -> None:
    data = write_mould(tmp_path / "cut.ply")
    (tmp_path / "cut.ply").write_bytes(data[: len(data) // 2])
    with pytest.raises(ScanError, match="announces"):
        load_scan(tmp_path / "cut.ply")


def test_a_missing_scan_is_a_clear_error(tmp_path: Path) -> None:
    with pytest.raises(ScanError, match="cannot be read"):
        load_scan(tmp_path / "absent.ply")


@pytest.mark.realdata
@pytest.mark.skipif(not (DATA / "potholes").is_dir(), reason="no recorded data here (HEADSUP_DATA)")
def test_real_moulds_become_road_potholes() -> None:
    for path in find_scans(DATA / "potholes"):
        hole = load_scan(path, length_m=0.9)
        assert hole.length_m == pytest.approx(0.9, abs=3 * GRID_STEP_M)
        assert 0.4 < hole.width_m <= 0.95
        assert SHALLOWEST_M <= hole.relief_m <= DEEPEST_M
        assert (hole.heights_m <= 0).all()


def test_a_mould_at_its_own_size_keeps_length_depth_and_volume(tmp_path: Path) -> None:
    write_mould(tmp_path / "mould.ply")
    hole = load_scan_true(tmp_path / "mould.ply")
    assert (hole.length_m, hole.width_m) == pytest.approx((0.080, 0.060), abs=0.0021)
    assert hole.relief_m == pytest.approx(0.030, abs=0.0005)
    # Half an ellipsoid.
    assert hole.volume_m3 == pytest.approx(2 / 3 * np.pi * 0.040 * 0.030 * 0.030, rel=0.04)


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 1000), st.floats(0.75, 1.4), st.floats(0.4, 0.6), st.floats(0.05, 0.15))
def test_a_hole_survives_being_moulded_and_scanned(seed: int, length: float, width: float, depth: float) -> None:
    """Longer than wide by a quarter: of a nearly round one, the longest side of the scan may be another."""
    hole = PotholeShape(length, width, depth, outline_roughness=0.02).relief(seed)
    with TemporaryDirectory() as folder:
        write_mould_of(Path(folder) / "mould.ply", hole)
        again = load_scan(Path(folder) / "mould.ply", hole.length_m, hole.relief_m)
    assert again.relief_m == pytest.approx(hole.relief_m)
    assert again.footprint_area_m2 == pytest.approx(hole.footprint_area_m2, rel=0.10)
    assert again.volume_m3 == pytest.approx(hole.volume_m3, rel=0.12)


def test_only_a_hole_has_a_mould(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="only a hole"):
        write_mould_of(tmp_path / "bump.ply", bump(1, 0.8, 0.6, 0.08))


@pytest.mark.parametrize(("length", "depth"), [(0.0, None), (11.0, None), (float("nan"), None), (0.9, 0.0), (0.9, 3.0)])
def test_a_scan_at_an_impossible_size_is_refused(tmp_path: Path, length: float, depth: float | None) -> None:
    write_mould(tmp_path / "mould.ply")
    with pytest.raises(ScanError, match="set into the road"):
        load_scan(tmp_path / "mould.ply", length, depth)


@pytest.mark.realdata
@pytest.mark.skipif(not (DATA / "potholes").is_dir(), reason="no recorded data here (HEADSUP_DATA)")
def test_real_moulds_at_their_own_size_keep_their_depth_and_volume() -> None:
    for path in find_scans(DATA / "potholes"):
        points = np.frombuffer(path.read_bytes().partition(b"end_header\n")[2], "<f4").reshape(-1, 3) / 1000.0
        depths = points[:, 2].astype(np.float64) - points[:, 2].min()
        hole = load_scan_true(path)
        assert hole.relief_m == pytest.approx(depths.max(), rel=0.03)
        # On a grid that is not turned; on walls as steep as these, grids of 0.5 to 2 mm differ by 4 %.
        cells, inverse = np.unique(np.rint(points[:, :2] * 1000).astype(int), axis=0, return_inverse=True)
        means = np.bincount(inverse.ravel(), depths) / np.bincount(inverse.ravel())
        assert hole.volume_m3 == pytest.approx(means.sum() * 1e-6, rel=0.05)
        assert hole.footprint_area_m2 == pytest.approx(len(cells) * 1e-6, rel=0.05)
