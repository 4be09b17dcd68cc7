from __future__ import annotations

import logging
import math
from pathlib import Path

import numpy as np
import pytest
import rosbags.rosbag1
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin

from tests.unit.vehicle_client.sources.ros_files import (
    COUNT,
    PERIOD_NS,
    PLACE,
    RING,
    SINCE_START_NS,
    START_NS,
    YAW_RAD,
    Messages,
    drive,
    points,
    write_bag,
)
from vehicle_client.sources.frame import LidarFrame, SourceError
from vehicle_client.sources.opening import SourceOptions, open_source

KINDS = {
    "bag of ROS 1": (1, StoragePlugin.SQLITE3),
    "SQLite": (2, StoragePlugin.SQLITE3),
    "MCAP": (2, StoragePlugin.MCAP),
}


def written(folder: Path, kind: str, said: list | None = None, frames: int = 4) -> Path:
    generation, storage = KINDS[kind]
    path = folder / ("drive.bag" if generation == 1 else "drive")
    return write_bag(path, generation, said or list(drive(Messages(generation), frames)), storage)


@pytest.fixture(scope="module", params=sorted(KINDS))
def bag(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("bag"), request.param)


@pytest.fixture(scope="module")
def frames(bag: Path) -> list[LidarFrame]:
    source = open_source(bag)
    found = list(source)
    assert len(source) == len(found) == 4
    assert source.skipped == 0
    return found


def test_points_rings_and_times_come_back(frames: list[LidarFrame]) -> None:
    for index, frame in enumerate(frames):
        assert frame.points_m.tolist() == points(index).tolist()
        assert frame.ring.tolist() == RING.tolist()
        assert frame.intensity.tolist() == [7.0] * COUNT
        end_s = (START_NS + index * PERIOD_NS) / 1e9 + 0.099
        assert frame.stamp_s == pytest.approx(end_s, abs=1e-6)
        assert frame.point_time_s == pytest.approx((SINCE_START_NS - 99_000_000.0) / 1e9, abs=1e-6)


def test_fixes_take_their_heading_from_the_inertial_unit(frames: list[LidarFrame]) -> None:
    for index, frame in enumerate(frames):
        fix = frame.gnss
        assert (fix.position.latitude_deg, fix.position.longitude_deg, fix.altitude_m) == PLACE
        assert (fix.sd_m, fix.altitude_sd_m) == (1.5, 3.0)
        assert fix.heading_rad == pytest.approx(math.pi / 2 - YAW_RAD)
        assert fix.stamp_s == pytest.approx((START_NS + index * PERIOD_NS) / 1e9, abs=1e-6)


def test_motions_and_pictures_keep_their_own_stamps(frames: list[LidarFrame]) -> None:
    begin_s = START_NS / 1e9 + 0.1
    assert [m.stamp_s for m in frames[1].motions] == pytest.approx([begin_s + 0.01, begin_s + 0.06], abs=1e-6)
    assert {m.yaw_rate_rps for m in frames[1].motions} == {0.1}
    assert frames[1].image_stamp_s == pytest.approx(begin_s + 0.03, abs=1e-6)
    assert frames[1].image[0, 0].tolist() == [0, 0, 101]  # red, as BGR


def test_the_pose_is_carried_on_to_the_sweeps_stamp(frames: list[LidarFrame]) -> None:
    # 10 m/s: 1.5 m at 150 ms, and the sweep ends 49 ms later.
    assert frames[1].odom_from_vehicle[:3, 3] == pytest.approx([1.99, 0, 0], abs=1e-5)
    assert frames[1].speed_mps == 10.0


@pytest.mark.parametrize(("big_endian", "padding"), [(True, 0), (False, 20), (True, 8)])
def test_any_byte_order_and_padding_gives_the_same_points(tmp_path: Path, big_endian: bool, padding: int) -> None:
    messages = Messages(2)
    cloud = messages.cloud(3, START_NS, big_endian=big_endian, padding=padding)
    (frame,) = open_source(write_bag(tmp_path / "bag", 2, [("/points", START_NS, cloud)]))
    assert frame.points_m.tolist() == points(3).tolist()
    assert frame.ring.tolist() == RING.tolist()


def test_a_message_that_announces_more_than_it_holds_is_left_out(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    messages = Messages(2)
    said = [("/points", START_NS + i * PERIOD_NS, messages.cloud(i, START_NS + i * PERIOD_NS)) for i in range(5)]
    said[1][2].width = 10_000_000
    said[2][2].fields[0].offset = 4_000_000_000
    said[3][2].point_step = 0
    with caplog.at_level(logging.WARNING):
        source = open_source(write_bag(tmp_path / "bag", 2, said))
        frames = list(source)
    assert [round((f.stamp_s - START_NS / 1e9) * 10) for f in frames] == [1, 5]
    assert source.skipped == len(caplog.messages) == 3


def test_stamps_that_jump_are_left_out_unless_the_next_agree(tmp_path: Path) -> None:
    messages = Messages(2)
    stamps = [0, 1, 1, 0, 2, 9_000_000, 3, 40_000, 40_001, 40_002, 40_003]
    said = []
    for order, stamp in enumerate(stamps):
        cloud = messages.cloud(order, START_NS + stamp * PERIOD_NS)
        said.append(("/points", START_NS + stamp * PERIOD_NS, cloud))
    # In a bag they come by log time; here each is logged when it is stamped, so only repeats and leaps remain.
    source = open_source(write_bag(tmp_path / "bag", 2, said))
    found = [round((f.stamp_s - START_NS / 1e9) * 10) - 1 for f in source]
    assert found == [0, 1, 2, 3, 40_002, 40_003]
    assert source.skipped == len(stamps) - len(found)


def test_several_lidars_are_told_apart_by_name_or_asked_about(tmp_path: Path) -> None:
    messages = Messages(2)
    cloud = messages.cloud(0, START_NS)
    path = write_bag(tmp_path / "a", 2, [("/lidar_top/points", START_NS, cloud), ("/radar/points", START_NS, cloud)])
    assert open_source(path).topics == {"sweep": "/lidar_top/points"}
    names = ["/lidar_left/points", "/lidar_right/points"]
    path = write_bag(tmp_path / "b", 2, [(name, START_NS, cloud) for name in names])
    with pytest.raises(SourceError, match="lidar_left/points, /lidar_right/points; say which"):
        open_source(path)
    source = open_source(path, SourceOptions(topics={"sweep": names[1]}))
    assert source.topics == {"sweep": names[1]}
    with pytest.raises(SourceError, match="no sweep topic /other; there are /lidar_left"):
        open_source(path, SourceOptions(topics={"sweep": "/other"}))
    with pytest.raises(SourceError, match="expected sweep, image"):
        open_source(path, SourceOptions(topics={"lidar": names[1]}))


def test_a_bag_without_point_clouds_lists_what_it_has(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", 2, [("/fix", START_NS, Messages(2).fix(START_NS))])
    with pytest.raises(SourceError, match=r"expected point clouds.*/fix \(sensor_msgs/msg/NavSatFix\)"):
        open_source(path)


def test_a_receiver_without_a_fix_and_a_unit_without_a_heading_say_nothing(tmp_path: Path) -> None:
    messages = Messages(2)
    said = [
        ("/fix", START_NS, messages.fix(START_NS, status=-1)),
        ("/fix", START_NS + PERIOD_NS, messages.fix(START_NS + PERIOD_NS)),
        ("/imu", START_NS + PERIOD_NS, messages.imu(START_NS + PERIOD_NS, yaw_variance=0.0)),
        *(("/points", START_NS + i * PERIOD_NS, messages.cloud(i, START_NS + i * PERIOD_NS)) for i in range(2)),
    ]
    source = open_source(write_bag(tmp_path / "bag", 2, said))
    first, second = source
    assert first.gnss is None
    assert second.gnss.heading_rad is None
    assert second.motions[0].yaw_rate_rps == 0.1
    assert source.skipped == 0


def test_velocities_are_the_cars_own_or_over_ground_by_their_topic(tmp_path: Path) -> None:
    messages = Messages(2)
    said = [
        ("/points", START_NS, messages.cloud(0, START_NS)),
        ("/fix", START_NS, messages.fix(START_NS)),
        ("/gps/vel", START_NS, messages.twist(START_NS, -3.0, 4.0, 0.0)),
        ("/vehicle/twist", START_NS, messages.twist(START_NS, 5.0, 0.0, 0.2)),
    ]
    (frame,) = open_source(write_bag(tmp_path / "bag", 2, said))
    assert (frame.gnss.speed_mps, frame.gnss.course_rad) == (5.0, pytest.approx(2 * math.pi - math.atan2(3, 4)))
    assert [(m.speed_mps, m.yaw_rate_rps) for m in frame.motions] == [(5.0, 0.2)]


def test_jpegs_are_read_and_a_cut_one_is_left_out(tmp_path: Path) -> None:
    messages = Messages(2)
    said = []
    for index in range(2):
        stamp = START_NS + index * PERIOD_NS
        picture = messages.jpeg(stamp, 90)
        if index == 1:
            picture.data = picture.data[:-30]
        said += [("/cam/image/compressed", stamp, picture), ("/points", stamp, messages.cloud(index, stamp))]
    source = open_source(write_bag(tmp_path / "bag", 2, said))
    first, second = source
    assert np.abs(first.image.astype(int) - 90).max() <= 2
    assert second.image is None
    assert source.skipped == 1


@pytest.mark.parametrize("kind", sorted(KINDS))
@pytest.mark.parametrize("share", [0.0, 0.4, 0.9])
def test_a_bag_that_was_cut_is_read_as_far_as_it_goes_or_refused(tmp_path: Path, kind: str, share: float) -> None:
    path = written(tmp_path, kind, frames=20)
    file = path if path.is_file() else next(p for p in path.iterdir() if p.suffix in (".db3", ".mcap"))
    file.write_bytes(file.read_bytes()[: int(file.stat().st_size * share)])
    try:
        source = open_source(path)
    except SourceError:
        return
    frames = list(source)
    assert len(frames) < 20
    assert source.skipped > 0
    assert all(np.diff([f.stamp_s for f in frames]) > 0)


@pytest.mark.parametrize("form", list(rosbags.rosbag1.Writer.CompressionFormat))
def test_compressed_bags_of_ros_1_are_read(tmp_path: Path, form: rosbags.rosbag1.Writer.CompressionFormat) -> None:
    compress = lambda writer: writer.set_compression(form)  # noqa: E731  # one line, used once
    path = write_bag(tmp_path / "drive.bag", 1, list(drive(Messages(1))), prepare=compress)
    assert len(list(open_source(path))) == 4


@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_compressed_bags_of_ros_2_are_read(tmp_path: Path, mode: CompressionMode) -> None:
    compress = lambda writer: writer.set_compression(mode, CompressionFormat.ZSTD)  # noqa: E731  # one line, used once
    path = write_bag(tmp_path / "drive", 2, list(drive(Messages(2))), prepare=compress)
    assert len(list(open_source(path))) == 4


def test_an_sqlite_bag_whose_description_is_missing_is_read_all_the_same(tmp_path: Path) -> None:
    path = written(tmp_path, "SQLite")
    (path / "metadata.yaml").unlink()
    assert len(list(open_source(path))) == 4


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """A short bag of each kind, as one file."""
    found = {}
    for kind in ("SQLite", "bag of ROS 1"):
        path = written(tmp_path_factory.mktemp("whole"), kind, frames=3)
        file = path if path.is_file() else next(path.glob("*.db3"))
        found[file.suffix] = file.read_bytes()
    return found


@settings(max_examples=80, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_whatever_is_corrupt_stamps_rise_and_nothing_else_is_raised(
    tmp_path: Path, whole: dict[str, bytes], data: st.DataObject
) -> None:
    ending = data.draw(st.sampled_from(sorted(whole)))
    corrupt = bytearray(whole[ending])
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(corrupt) - 1))
        corrupt[at : at + 8] = data.draw(st.binary(max_size=8))
    path = tmp_path / f"corrupt{ending}"
    path.write_bytes(corrupt[: data.draw(st.just(len(corrupt)) | st.integers(0, len(corrupt)))])
    try:
        stamps = [frame.stamp_s for frame in open_source(path)]
    except SourceError:
        return
    assert all(math.isfinite(stamp) for stamp in stamps)
    assert all(np.diff(stamps) > 0)
