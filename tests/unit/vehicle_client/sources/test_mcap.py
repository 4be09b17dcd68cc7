from __future__ import annotations

import logging
import math
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import zstandard
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from google.protobuf.timestamp_pb2 import Timestamp
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk
from mcap.writer import CompressionType, Writer

from tests.unit.simulator.recording_frames import (
    CAMERA,
    ENU_FROM_STREET,
    GEOREFERENCE,
    GNSS,
    IMU,
    LIDAR,
    ego_frame,
    header,
    street_from_vehicle,
    write_recording,
)
from vehicle_client.frames import GeoOrigin, heading_from_yaw, yaw_of
from vehicle_client.sources.frame import LidarFrame, SourceError
from vehicle_client.sources.opening import open_source

FRAMES = 4
NAMES = (LIDAR, CAMERA, GNSS, IMU)
START_NS = 1_780_000_000_000_000_000
PERIOD_NS = 100_000_000


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("mcap") / "run"
    write_recording(folder, frames=FRAMES, egos=1, names=NAMES)
    return folder / "ego0.mcap"


@pytest.fixture(scope="module")
def frames(recorded: Path) -> list[LidarFrame]:
    source = open_source(recorded)
    found = list(source)
    assert len(source) == len(found) == FRAMES
    assert source.skipped == 0
    return found


def made(index: int, name: object) -> object:
    return next(r for r in ego_frame(index, names=NAMES).readings if r.sensor == name)


def test_what_the_simulator_wrote_comes_back_point_for_point(frames: list[LidarFrame]) -> None:
    for index, frame in enumerate(frames):
        sweep = made(index, LIDAR).sweep
        assert frame.stamp_s == pytest.approx(header().start_ns / 1e9 + index * 0.1, abs=1e-6)
        assert frame.points_m.tolist() == sweep.points_m.tolist()
        assert frame.ring.tolist() == sweep.ring.tolist()
        assert frame.intensity.tolist() == sweep.intensity.tolist()
        assert frame.point_time_s == pytest.approx(sweep.time_offset_s, abs=1e-6)


def test_what_was_said_at_the_sweeps_moment_belongs_to_it(frames: list[LidarFrame]) -> None:
    for index, frame in enumerate(frames):
        assert frame.odom_from_vehicle == pytest.approx(ego_frame(index).odom_from_vehicle)
        assert frame.steering_rad == pytest.approx(0.05 - 0.01 * index)
        assert frame.speed_mps == 12.0
        _, jpeg = cv2.imencode(".jpg", made(index, CAMERA).pixels, (cv2.IMWRITE_JPEG_QUALITY, 90))
        assert frame.image.tolist() == cv2.imdecode(jpeg, cv2.IMREAD_COLOR).tolist()
        rates = [m.yaw_rate_rps for m in frame.motions if m.yaw_rate_rps is not None]
        assert rates == [pytest.approx(made(index, IMU).gyroscope_radps[2])]


def test_the_fix_is_moved_from_the_antenna_to_the_vehicles_origin(frames: list[LidarFrame]) -> None:
    origin = GeoOrigin(GEOREFERENCE.position, GEOREFERENCE.altitude_m)
    for index, frame in enumerate(frames):
        enu_from_vehicle = ENU_FROM_STREET @ street_from_vehicle(index)
        # The simulated car pitches and rolls by some hundredths, which the lever of a level car leaves.
        fixed = origin.enu(frame.gnss.position, frame.gnss.altitude_m)
        assert fixed == pytest.approx(enu_from_vehicle[:3, 3], abs=0.1)
        assert frame.gnss.heading_rad == pytest.approx(heading_from_yaw(yaw_of(enu_from_vehicle)), abs=1e-3)
        assert (frame.gnss.sd_m, frame.gnss.altitude_sd_m) == (1.5, 3.0)


def cloud(stamp_ns: int, seed: int = 0, count: int = 50) -> bytes:
    points = np.random.default_rng(seed).normal(0, 10, (count, 3)).astype("<f4")
    kinds = [PackedElementField(name=n, offset=4 * i, type=PackedElementField.FLOAT32) for i, n in enumerate("xyz")]
    stamp = Timestamp(seconds=stamp_ns // 10**9, nanos=stamp_ns % 10**9)
    message = PointCloud(timestamp=stamp, frame_id="lidar", point_stride=12, fields=kinds, data=points.tobytes())
    return bytes(message.SerializeToString())


def write_mcap(
    path: Path,
    frames: int = 6,
    make: Callable[[int], bytes] = lambda i: cloud(START_NS + i * PERIOD_NS, i),
    finish: bool = True,
    **settings: object,
) -> Path:
    """A cloud every 100 ms in a chunk of its own, and a fix 50 ms before it, written after it."""
    with path.open("wb") as stream:
        writer = Writer(stream, **{"chunk_size": 700, **settings})
        writer.start()
        channels = {}
        for topic, kind in (("/lidar", PointCloud), ("/fix", LocationFix)):
            schema = writer.register_schema(kind.DESCRIPTOR.full_name, "protobuf", b"")
            channels[topic] = writer.register_channel(topic, "protobuf", schema)
        for index in range(frames):
            time_ns = START_NS + index * PERIOD_NS
            writer.add_message(channels["/lidar"], log_time=time_ns, publish_time=time_ns, data=make(index))
            fix = LocationFix(latitude=49.0, longitude=8.0 + index, altitude=100.0)
            earlier = time_ns - 50_000_000
            writer.add_message(channels["/fix"], log_time=earlier, publish_time=earlier, data=fix.SerializeToString())
        if finish:
            writer.finish()
    return path


@pytest.mark.parametrize(
    "settings",
    [
        {"compression": CompressionType.NONE},
        {"compression": CompressionType.LZ4},
        {"compression": CompressionType.ZSTD},
        {"use_chunking": False},
        {"use_summary_offsets": False, "use_statistics": False, "repeat_channels": False, "repeat_schemas": False},
    ],
)
def test_any_form_of_the_container_is_read_by_log_time(tmp_path: Path, settings: dict[str, object]) -> None:
    source = open_source(write_mcap(tmp_path / "drive.mcap", **settings))
    found = list(source)
    assert len(source) == len(found) == 6
    assert source.skipped == 0
    if settings.get("use_chunking", True):
        # The fix was made before its sweep, although it stands behind it.
        assert [f.gnss.position.longitude_deg for f in found] == pytest.approx([8, 9, 10, 11, 12, 13])


def test_a_recording_that_was_killed_is_read_as_far_as_it_was_written(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = write_mcap(tmp_path / "drive.mcap", frames=10, finish=False)
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * 0.9)])
    with caplog.at_level(logging.WARNING):
        source = open_source(path)
        found = list(source)
    assert 7 <= len(found) < 10
    assert source.skipped == len(caplog.messages) == 1
    assert "ends within a record" in caplog.text


def test_a_corrupt_chunk_costs_its_own_messages_alone(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_mcap(tmp_path / "drive.mcap", frames=12, compression=CompressionType.NONE)
    data = bytearray(path.read_bytes())
    at = data.index(cloud(START_NS + 5 * PERIOD_NS, 5)[-100:])
    data[at : at + 4] = b"\0\1\2\3"
    path.write_bytes(data)
    with caplog.at_level(logging.WARNING):
        source = open_source(path)
        found = list(source)
    assert [round((f.stamp_s - START_NS / 1e9) * 10) for f in found] == [i for i in range(12) if i != 5]
    assert source.skipped == 1
    assert "checksum" in caplog.text


@pytest.mark.parametrize("announced", [1000, 2**40])
def test_a_chunk_that_would_fill_the_memory_is_not_unpacked(tmp_path: Path, announced: int) -> None:
    path = write_mcap(tmp_path / "drive.mcap", finish=False)
    packed = zstandard.compress(b"\0" * 50_000_000)
    bomb = Chunk("zstd", packed, START_NS + 10 * PERIOD_NS, START_NS + 10 * PERIOD_NS, 0, announced)
    builder = RecordBuilder()
    bomb.write(builder)
    path.write_bytes(path.read_bytes() + builder.end())
    source = open_source(path)
    tracemalloc.start()
    found = list(source)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(found) >= 5
    assert source.skipped == 2  # the chunk, and that the file was not finished
    assert peak < 10_000_000


@pytest.mark.parametrize(
    "bad",
    [
        b"",
        b"\xff" * 50,
        cloud(START_NS)[:-7],
        PointCloud(point_stride=12, data=b"\0" * 24).SerializeToString(),
        PointCloud(point_stride=0, data=b"\0" * 24).SerializeToString(),
        PointCloud(
            point_stride=4, fields=[PackedElementField(name="x", offset=2**31, type=7)], data=b"\0" * 24
        ).SerializeToString(),
    ],
)
def test_a_message_that_makes_no_sense_is_one_warning(
    tmp_path: Path, bad: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    make = lambda i: bad if i == 1 else cloud(START_NS + i * PERIOD_NS, i)  # noqa: E731  # one line, used once
    with caplog.at_level(logging.WARNING):
        source = open_source(write_mcap(tmp_path / "drive.mcap", make=make))
        found = list(source)
    assert len(found) == 5
    assert source.skipped == len(caplog.messages) == 1
    assert "/lidar" in caplog.text


def test_a_file_without_clouds_says_what_is_in_it(tmp_path: Path) -> None:
    with (tmp_path / "empty.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("std_msgs/String", "ros1msg", b"")
        channel = writer.register_channel("/chatter", "ros1", schema)
        writer.add_message(channel, log_time=1, publish_time=1, data=b"")
        writer.finish()
    with pytest.raises(SourceError, match=r"expected point clouds.*/chatter \(std_msgs/String, ros1\)"):
        open_source(tmp_path / "empty.mcap")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("whole") / "drive.mcap"
    return write_mcap(path, frames=5, compression=CompressionType.NONE).read_bytes()


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_whatever_is_corrupt_stamps_rise_and_nothing_else_is_raised(
    tmp_path: Path, whole: bytes, data: st.DataObject
) -> None:
    corrupt = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(corrupt) - 1))
        corrupt[at : at + 8] = data.draw(st.binary(max_size=8))
    path = tmp_path / "corrupt.mcap"
    path.write_bytes(corrupt[: data.draw(st.just(len(corrupt)) | st.integers(0, len(corrupt)))])
    try:
        source = open_source(path)
    except SourceError:
        return
    stamps = [frame.stamp_s for frame in source]
    assert all(math.isfinite(stamp) for stamp in stamps)
    assert all(np.diff(stamps) > 0)
