from __future__ import annotations

import os
from pathlib import Path

import laspy
import numpy as np
import open3d as o3d
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from vehicle_client.sources.files import READERS, read_cloud
from vehicle_client.sources.frame import SourceError

DATA = Path(os.environ.get("HEADSUP_DATA", "../shared/data"))
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="no recorded data here (HEADSUP_DATA)")

ENDINGS = sorted(READERS)


def sweep(count: int = 500) -> np.ndarray:
    return np.random.default_rng(0).normal(0, 20, (count, 3)).astype(np.float32)


def write_cloud(path: Path, points: np.ndarray) -> None:
    """Points of the sensor frame in the format of the path's ending."""
    ones = np.ones((len(points), 1), dtype=np.float32)
    if path.name.endswith(".pcd.bin"):
        turned = np.column_stack([-points[:, 1], points[:, 0], points[:, 2], 7 * ones, 3 * ones])
        path.write_bytes(turned.astype("<f4").tobytes())
    elif path.suffix == ".bin":
        path.write_bytes(np.column_stack([points, ones]).astype("<f4").tobytes())
    elif path.suffix in (".ply", ".pcd"):
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.astype(np.float64)))
        assert o3d.io.write_point_cloud(path, cloud)
    elif path.suffix in (".las", ".laz"):
        las = laspy.create(point_format=0)
        las.header.scales = [0.001, 0.001, 0.001]
        las.x, las.y, las.z = points.astype(np.float64).T
        las.write(path)
    elif path.suffix == ".npy":
        np.save(path, points)
    else:
        np.savez(path, points=points)


@pytest.mark.parametrize("ending", ENDINGS)
def test_every_format_gives_the_points_in_the_sensor_frame_in_order(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"cloud{ending}"
    write_cloud(path, sweep())
    frame = read_cloud(path)
    assert frame.points_m.dtype == np.float32
    assert frame.points_m == pytest.approx(sweep(), abs=0.0006)


@pytest.mark.parametrize("ending", [e for e in ENDINGS if e not in (".las", ".laz")])
def test_points_that_are_not_finite_keep_their_place(tmp_path: Path, ending: str) -> None:
    points = sweep()
    points[7] = np.nan
    write_cloud(tmp_path / f"cloud{ending}", points)
    read = read_cloud(tmp_path / f"cloud{ending}").points_m
    assert len(read) == len(points)
    assert np.flatnonzero(np.isnan(read).any(axis=1)).tolist() == [7]


@pytest.mark.parametrize("ending", ENDINGS)
@pytest.mark.parametrize("share", [0.3, 0.7, 0.999])
def test_a_file_that_ends_early_is_refused(tmp_path: Path, ending: str, share: float) -> None:
    path = tmp_path / f"cut{ending}"
    write_cloud(path, sweep(501))
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share) | 1])
    with pytest.raises(SourceError, match="cut"):
        read_cloud(path)


@pytest.mark.parametrize("kind", [{"write_ascii": True}, {"compressed": True}])
@pytest.mark.parametrize("ending", [".ply", ".pcd"])
def test_text_and_compressed_clouds_are_read_and_refused_when_cut(
    tmp_path: Path, ending: str, kind: dict[str, bool]
) -> None:
    path = tmp_path / f"cloud{ending}"
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(sweep().astype(np.float64)))
    o3d.io.write_point_cloud(path, cloud, **kind)
    assert read_cloud(path).points_m == pytest.approx(sweep(), abs=1e-4)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(SourceError, match="announces"):
        read_cloud(path)


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_cloud_without_points_is_refused(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"none{ending}"
    if ending in (".ply", ".pcd"):
        path.write_bytes(b"")
    else:
        write_cloud(path, sweep(0))
    with pytest.raises(SourceError, match="none"):
        read_cloud(path)


def test_a_cloud_of_nothing_finite_is_refused(tmp_path: Path) -> None:
    write_cloud(tmp_path / "nan.bin", np.full((10, 3), np.nan, dtype=np.float32))
    with pytest.raises(SourceError, match="none of its 10 points is finite"):
        read_cloud(tmp_path / "nan.bin")


def test_map_coordinates_are_refused(tmp_path: Path) -> None:
    write_cloud(tmp_path / "utm.npy", sweep() + np.float32(500_000))
    with pytest.raises(SourceError, match="metres in the sensor's frame"):
        read_cloud(tmp_path / "utm.npy")


def test_as_many_points_beyond_a_kilometre_as_within_are_noise_and_more_are_refused(tmp_path: Path) -> None:
    near, far, none = [[1.0, 2.0, 3.0]] * 3, [[1.0, -2_000.0, 3.0]] * 3, [[np.nan, 5_000.0, 0.0]] * 9
    path = tmp_path / "cloud.npy"
    np.save(path, np.array(near + far + none, dtype=np.float32))
    assert len(read_cloud(path).points_m) == 15
    np.save(path, np.array(near[1:] + far + none, dtype=np.float32))
    with pytest.raises(SourceError, match="most points are beyond 1 km"):
        read_cloud(path)


@pytest.mark.parametrize("name", ["cloud.txt", "cloud", "cloud.bin.gz"])
def test_an_unknown_ending_is_refused_with_those_that_are_known(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"x")
    with pytest.raises(SourceError, match=r"\.pcd\.bin"):
        read_cloud(tmp_path / name)


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    (tmp_path / "folder.bin").mkdir()
    for name in ("absent.bin", "folder.bin"):
        with pytest.raises(SourceError, match="no such file"):
            read_cloud(tmp_path / name)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(ending=st.sampled_from(ENDINGS), data=st.binary(max_size=300), at=st.integers(0, 400))
def test_corrupt_bytes_give_a_cloud_or_a_clear_error(tmp_path: Path, ending: str, data: bytes, at: int) -> None:
    path = tmp_path / f"corrupt{ending}"
    write_cloud(path, sweep(40))
    whole = path.read_bytes()
    path.write_bytes(whole[:at] + data + whole[at + len(data) :])
    try:
        frame = read_cloud(path)
    except SourceError:
        return
    assert frame.points_m.shape == (len(frame.points_m), 3)


@pytest.mark.parametrize("offset", [100, 107])
def test_a_las_header_that_announces_billions_is_refused_before_they_are_read(tmp_path: Path, offset: int) -> None:
    write_cloud(tmp_path / "vast.las", sweep())
    data = bytearray((tmp_path / "vast.las").read_bytes())
    data[offset : offset + 4] = b"\xff\xff\xff\xff"
    (tmp_path / "vast.las").write_bytes(data)
    with pytest.raises(SourceError, match="announces"):
        read_cloud(tmp_path / "vast.las")


def test_a_numpy_array_may_carry_intensity_but_no_other_shape(tmp_path: Path) -> None:
    np.save(tmp_path / "four.npy", np.column_stack([sweep(), np.arange(500)]))
    intensity = read_cloud(tmp_path / "four.npy").intensity
    assert intensity is not None
    assert intensity.tolist() == list(range(500))
    np.save(tmp_path / "flat.npy", np.arange(30.0))
    with pytest.raises(SourceError, match="expected an array of numbers"):
        read_cloud(tmp_path / "flat.npy")


def test_an_archive_of_several_arrays_needs_one_called_points(tmp_path: Path) -> None:
    np.savez(tmp_path / "both.npz", other=np.zeros(3), points=sweep())
    assert len(read_cloud(tmp_path / "both.npz").points_m) == 500
    np.savez(tmp_path / "neither.npz", a=sweep(), b=sweep())
    with pytest.raises(SourceError, match="points"):
        read_cloud(tmp_path / "neither.npz")


def test_an_array_of_objects_is_not_unpickled(tmp_path: Path) -> None:
    np.save(tmp_path / "objects.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(SourceError, match="NumPy"):
        read_cloud(tmp_path / "objects.npy")


def test_a_ring_that_is_no_whole_number_is_no_nuscenes_scan(tmp_path: Path) -> None:
    rows = np.column_stack([sweep(), np.ones(500), np.full(500, 0.5)]).astype("<f4")
    (tmp_path / "odd.pcd.bin").write_bytes(rows.tobytes())
    with pytest.raises(SourceError, match="ring"):
        read_cloud(tmp_path / "odd.pcd.bin")


@pytest.mark.realdata
@needs_data
def test_a_real_kitti_scan_has_the_road_below_the_sensor() -> None:
    frame = read_cloud(sorted((DATA / "kitti_sequence/velodyne").glob("*.bin"))[0])
    x, y, z = frame.points_m.T
    ahead = z[(x > 5) & (x < 10) & (np.abs(y) < 2)]
    assert len(frame.points_m) > 100_000
    assert np.median(ahead) == pytest.approx(-1.73, abs=0.15)


@pytest.mark.realdata
@needs_data
def test_a_real_nuscenes_scan_is_turned_to_look_ahead() -> None:
    frame = read_cloud(DATA / "nuscenes/lidar_top.pcd.bin")
    raw = np.fromfile(DATA / "nuscenes/lidar_top.pcd.bin", "<f4").reshape(-1, 5)
    assert frame.points_m[:, 0].tolist() == raw[:, 1].tolist()
    assert frame.points_m[:, 1].tolist() == (-raw[:, 0]).tolist()
    assert frame.ring is not None
    assert np.unique(frame.ring).tolist() == list(range(32))


@pytest.mark.realdata
@needs_data
def test_a_real_laz_scan_keeps_its_two_millimetre_grid() -> None:
    frame = read_cloud(DATA / "kitti_drive/0000.laz")
    assert len(frame.points_m) > 115_000
    assert np.abs(frame.points_m / 0.002 - np.rint(frame.points_m / 0.002)).max() < 0.05
    assert frame.intensity is not None
