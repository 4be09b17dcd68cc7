from __future__ import annotations

import logging
from pathlib import Path

import pytest

from tests.unit.simulator.recording_frames import CAMERA, GNSS, IMU, LIDAR, write_recording
from tests.unit.vehicle_client.sources.kitti_files import cloud, write_odometry, write_raw
from tests.unit.vehicle_client.sources.test_kitti import KARLSRUHE
from vehicle_client.sources.carla_recording import CarlaRecording
from vehicle_client.sources.cloud_folder import CloudFolder
from vehicle_client.sources.complaints import ALL_SAID, Complaints
from vehicle_client.sources.frame import SourceError
from vehicle_client.sources.kitti_odometry import KittiOdometry
from vehicle_client.sources.kitti_raw import KittiRaw
from vehicle_client.sources.log_source import LogSource
from vehicle_client.sources.opening import SourceOptions, open_source


def test_every_drive_is_recognised_by_what_it_holds(tmp_path: Path) -> None:
    write_recording(tmp_path / "run", frames=2, egos=2, names=(LIDAR, CAMERA, GNSS, IMU))
    (tmp_path / "one.bin").write_bytes(cloud(0).tobytes())
    renamed = tmp_path / "no_ending"
    renamed.write_bytes((tmp_path / "run/ego1.mcap").read_bytes())
    for place, kind in (
        (tmp_path / "run", CarlaRecording),
        (tmp_path / "run/ego1", CarlaRecording),
        (tmp_path / "run/ego1.mcap", LogSource),
        (renamed, LogSource),
        (write_raw(tmp_path / "raw", KARLSRUHE), KittiRaw),
        (write_odometry(tmp_path / "odometry"), KittiOdometry),
        (tmp_path / "one.bin", CloudFolder),
        (tmp_path, CloudFolder),
    ):
        source = open_source(str(place))
        assert type(source) is kind, place
        assert len(list(source)) == len(source) > 0
        assert source.skipped == 0


def test_an_ego_is_chosen_by_its_folder_or_by_number(tmp_path: Path) -> None:
    write_recording(tmp_path / "run", frames=1, egos=2, names=(LIDAR, GNSS))
    by_folder, by_number, other = (
        next(iter(open_source(place, options)))
        for place, options in (
            (tmp_path / "run/ego1", None),
            (tmp_path / "run", SourceOptions(ego=1)),
            (tmp_path / "run", None),
        )
    )
    assert by_folder.gnss == by_number.gnss
    assert by_folder.gnss != other.gnss


@pytest.mark.parametrize("name", ["absent", "folder", "text.txt", "empty.mcap", "empty.bag", "empty.db3"])
def test_what_is_no_drive_is_refused_with_what_was_expected(tmp_path: Path, name: str) -> None:
    if name == "folder":
        (tmp_path / name).mkdir()
    elif name != "absent":
        (tmp_path / name).write_bytes(b"")
    with pytest.raises(SourceError, match=r"expected a recording in CARLA's layout.*KITTI.*MCAP.*ROS bag.*udp://"):
        open_source(tmp_path / name)


def test_a_corrupt_mcap_file_is_named_also_within_a_folder(tmp_path: Path) -> None:
    write_recording(tmp_path / "run", frames=1, egos=1, names=(LIDAR,))
    drives = tmp_path / "drives"
    drives.mkdir()
    (drives / "a.mcap").write_bytes(b"\0" * 100)
    with pytest.raises(SourceError, match=r"a\.mcap: corrupt: it does not begin as an MCAP file"):
        open_source(drives / "a.mcap")
    with pytest.raises(SourceError, match=r"none of its 1 MCAP files can be read: .*a\.mcap"):
        open_source(drives)
    (drives / "b.mcap").write_bytes((tmp_path / "run/ego0.mcap").read_bytes())
    with pytest.raises(SourceError, match=r"2 MCAP files, of which corrupt: a\.mcap; name one, such as .*b\.mcap$"):
        open_source(drives)


def test_a_folder_of_drives_asks_for_one_of_them(tmp_path: Path) -> None:
    write_odometry(tmp_path / "odometry")
    write_raw(tmp_path / "raw", KARLSRUHE)
    write_recording(tmp_path / "runs/0001", frames=1, egos=1, names=(LIDAR, GNSS), mcap=False)
    for place, one in (
        ("odometry", "sequences/07"),
        ("raw", "2011_09_26/2011_09_26_drive_0001_sync"),
        ("raw/2011_09_26", "2011_09_26_drive_0001_sync"),
        ("runs", "0001"),
    ):
        with pytest.raises(SourceError, match=f"holds 1 drives; name one, such as {tmp_path / place / one}"):
            open_source(tmp_path / place)


@pytest.mark.parametrize("rate_hz", [0.0, -1.0, float("nan"), 1e9])
def test_a_rate_without_sense_is_refused(tmp_path: Path, rate_hz: float) -> None:
    with pytest.raises(SourceError, match="rate"):
        open_source(tmp_path, SourceOptions(rate_hz=rate_hz))


def test_a_year_of_complaints_fills_no_disk(caplog: pytest.LogCaptureFixture) -> None:
    complaints = Complaints()
    with caplog.at_level(logging.WARNING):
        for _ in range(100 * ALL_SAID):
            complaints.add("a part was lost")
    assert complaints.count == 100 * ALL_SAID
    assert len(caplog.messages) == ALL_SAID + 99
