from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.unit.vehicle_client.sources.kitti_files import cloud
from vehicle_client.sources.cloud_folder import CloudFolder
from vehicle_client.sources.frame import SourceError
from vehicle_client.sources.opening import open_source

DATA = Path(os.environ.get("HEADSUP_DATA", Path(__file__).parents[5] / "shared" / "data"))
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="no recorded data here (HEADSUP_DATA)")


def write_clouds(folder: Path, names: list[str]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for index, name in enumerate(names):
        (folder / name).write_bytes(cloud(index).tobytes())
    return folder


def test_clouds_come_in_the_order_of_the_numbers_in_their_names(tmp_path: Path) -> None:
    write_clouds(tmp_path, ["9.bin", "10.bin", "1.bin"])
    frames = list(CloudFolder(tmp_path, rate_hz=20, start_s=100))
    assert [f.points_m[0].tolist() for f in frames] == [cloud(i)[0, :3].tolist() for i in (2, 0, 1)]
    assert [f.stamp_s for f in frames] == pytest.approx([100, 100.05, 100.1])


def test_a_corrupt_cloud_leaves_a_gap_in_time_not_a_shift(tmp_path: Path) -> None:
    write_clouds(tmp_path, ["0.bin", "1.bin", "2.bin"])
    (tmp_path / "1.bin").write_bytes(b"12345")
    source = CloudFolder(tmp_path)
    assert [f.stamp_s for f in source] == pytest.approx([0, 0.2])
    assert (len(source), source.skipped) == (3, 1)


@pytest.mark.parametrize("names", [["0.png", "1.png"], ["a.png", "b.png"]])
def test_pictures_are_paired_by_name_or_by_number(tmp_path: Path, names: list[str]) -> None:
    write_clouds(tmp_path / "velodyne", ["0.bin", "1.bin"])
    (tmp_path / "image").mkdir()
    for index, name in enumerate(names):
        cv2.imwrite(str(tmp_path / "image" / name), np.full((4, 4, 3), 10 + index, np.uint8))
    for place in (tmp_path, tmp_path / "velodyne"):
        assert [int(f.image[0, 0, 0]) for f in CloudFolder(place)] == [10, 11]


def test_pictures_of_another_number_are_not_guessed_at(tmp_path: Path) -> None:
    write_clouds(tmp_path / "velodyne", ["0.bin", "1.bin"])
    (tmp_path / "image").mkdir()
    cv2.imwrite(str(tmp_path / "image/a.png"), np.zeros((4, 4, 3), np.uint8))
    assert [f.image for f in CloudFolder(tmp_path)] == [None, None]


def test_a_folder_without_clouds_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"\.pcd\.bin"):
        CloudFolder(tmp_path)


@pytest.mark.realdata
@needs_data
def test_the_real_sequence_has_sixteen_sweeps_with_pictures() -> None:
    source = open_source(DATA / "kitti_sequence")
    frames = list(source)
    assert len(source) == len(frames) == 16
    assert all(len(f.points_m) > 100_000 and f.image is not None and f.image.shape[2] == 3 for f in frames)
    assert source.skipped == 0


@pytest.mark.realdata
@needs_data
def test_the_real_drive_is_read_in_order_at_ten_hertz() -> None:
    source = open_source(DATA / "kitti_drive")
    first = [frame for frame, _ in zip(source, range(5), strict=False)]
    assert len(source) == 154
    assert [f.stamp_s for f in first] == pytest.approx([0, 0.1, 0.2, 0.3, 0.4])
    assert all(len(f.points_m) > 100_000 for f in first)


@pytest.mark.realdata
@needs_data
@pytest.mark.parametrize("place", ["nuscenes", "nuscenes/lidar_top.pcd.bin", "kitti_object"])
def test_single_real_frames_are_drives_of_one_sweep(place: str) -> None:
    source = open_source(DATA / place)
    (frame,) = source
    assert len(frame.points_m) > 30_000
