from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.reader import make_reader
from scipy.spatial.transform import Rotation

from tests.unit.simulator.recording_frames import (
    CAMERA,
    ENU_FROM_STREET,
    GNSS,
    IMU,
    LIDAR,
    MOUNTED,
    ego_frame,
    header,
    obstacle,
    street_from_vehicle,
    sweep,
    write_recording,
)

FRAMES = 4

NUMBERS = {
    PackedElementField.UINT8: "u1",
    PackedElementField.UINT16: "<u2",
    PackedElementField.INT32: "<i4",
    PackedElementField.FLOAT32: "<f4",
}


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("mcap") / "run"
    write_recording(folder, frames=FRAMES, egos=1)
    return folder / "ego0.mcap"


@pytest.fixture(scope="module")
def messages(path: Path) -> dict[str, list]:
    """Every message by topic, decoded with the schemas of the file alone, as any reader would."""
    found: dict[str, list] = {}
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            if channel.message_encoding == "json":
                value = json.loads(message.data)
            else:
                pool = descriptor_pool.DescriptorPool()
                for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
                    pool.Add(file)
                value = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name)).FromString(
                    message.data
                )
            found.setdefault(channel.topic, []).append((message.log_time, value))
    return found


def reading(index: int, name: object) -> object:
    return next(r for r in ego_frame(index).readings if r.sensor == name)


def matrix(translation: object, rotation: object) -> np.ndarray:
    transform = np.eye(4)
    transform[:3, :3] = Rotation.from_quat([rotation.x, rotation.y, rotation.z, rotation.w]).as_matrix()
    transform[:3, 3] = (translation.x, translation.y, translation.z)
    return transform


def test_the_file_is_compressed_indexed_and_counts_its_messages(path: Path, messages: dict[str, list]) -> None:
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
        stream.seek(0)
        written_by = make_reader(stream).get_header()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == sum(len(found) for found in messages.values())
    assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
    assert written_by.library == "headsup"


def test_every_topic_has_a_message_a_frame(messages: dict[str, list]) -> None:
    assert {topic: len(found) for topic, found in messages.items()} == {
        "/sensor.lidar.ray_cast": FRAMES,
        "/sensor.lidar.ray_cast_semantic": FRAMES,
        "/sensor.camera.rgb": FRAMES,
        "/sensor.camera.rgb/calibration": FRAMES,
        "/sensor.camera.semantic_segmentation": FRAMES,
        "/sensor.camera.semantic_segmentation/calibration": FRAMES,
        "/gnss": FRAMES,
        "/imu": FRAMES,
        "/pose": FRAMES,
        "/odometry": FRAMES,
        "/vehicle": FRAMES,
        "/tf": FRAMES,
        "/obstacles": 3,
    }


def test_a_cloud_holds_every_number_of_the_sweep(messages: dict[str, list]) -> None:
    for index, (time_ns, cloud) in enumerate(messages[f"/{LIDAR.type}"]):
        kind = np.dtype(
            {
                "names": [f.name for f in cloud.fields],
                "formats": [NUMBERS[f.type] for f in cloud.fields],
                "offsets": [f.offset for f in cloud.fields],
                "itemsize": cloud.point_stride,
            }
        )
        points, made = np.frombuffer(cloud.data, dtype=kind), sweep(index)
        assert time_ns == header().start_ns + index * 100_000_000
        assert np.stack([points["x"], points["y"], points["z"]], axis=1).tolist() == made.points_m.tolist()
        for name in ("intensity", "ring", "surface", "obstacle_id", "mover_id"):
            assert points[name].tolist() == getattr(made, name).tolist(), name
        assert points["time_offset"].tolist() == made.time_offset_s.tolist()


def test_a_picture_reads_back_as_a_jpeg_shows_it(messages: dict[str, list]) -> None:
    for index, (_, image) in enumerate(messages[f"/{CAMERA.type}"]):
        assert image.format == "jpeg"
        made = reading(index, CAMERA).pixels
        _, expected = cv2.imencode(".jpg", made, (cv2.IMWRITE_JPEG_QUALITY, 90))
        assert image.data == expected.tobytes()
        assert cv2.imdecode(np.frombuffer(image.data, np.uint8), cv2.IMREAD_COLOR).shape == made.shape


def test_the_calibration_is_a_pinhole_with_carlas_default_view_of_ninety_degrees(messages: dict[str, list]) -> None:
    calibration = messages[f"/{CAMERA.type}/calibration"][0][1]
    assert (calibration.width, calibration.height) == (48, 24)
    assert list(calibration.K) == pytest.approx([24, 0, 24, 0, 24, 12, 0, 0, 1])


def test_fixes_carry_place_and_variance(messages: dict[str, list]) -> None:
    for index, (_, fix) in enumerate(messages["/gnss"]):
        made = reading(index, GNSS)
        assert (fix.latitude, fix.longitude) == (made.position.latitude_deg, made.position.longitude_deg)
        assert fix.altitude == made.altitude_m
        assert list(fix.position_covariance) == [2.25, 0, 0, 0, 2.25, 0, 0, 0, 9.0]


def test_inertia_is_json_that_can_be_plotted(messages: dict[str, list]) -> None:
    for index, (_, value) in enumerate(messages["/imu"]):
        made = reading(index, IMU)
        assert [value["accelerometer_mps2"][a] for a in "xyz"] == made.accelerometer_mps2.tolist()
        assert value["compass_rad"] == made.compass_rad


def test_frames_chain_from_the_earth_to_each_sensor(messages: dict[str, list]) -> None:
    for index, (_, message) in enumerate(messages["/tf"]):
        frames = {t.child_frame_id: (t.parent_frame_id, matrix(t.translation, t.rotation)) for t in message.transforms}
        assert frames["street"][0] == "enu"
        assert frames["street"][1] == pytest.approx(ENU_FROM_STREET)
        assert frames["vehicle"][1] == pytest.approx(street_from_vehicle(index))
        assert frames[LIDAR.type][0] == "vehicle"
        assert frames[LIDAR.type][1] == pytest.approx(MOUNTED[LIDAR])
        parent, camera_from_optical = frames[f"{CAMERA.type}.optical"]
        assert parent == CAMERA.type
        assert camera_from_optical @ [0, 0, 1, 1] == pytest.approx([1, 0, 0, 1])  # the optical axis looks ahead


def test_poses_and_odometry_are_exact(messages: dict[str, list]) -> None:
    for index in range(FRAMES):
        pose = messages["/pose"][index][1].pose
        assert matrix(pose.position, pose.orientation) == pytest.approx(ENU_FROM_STREET @ street_from_vehicle(index))
        pose = messages["/odometry"][index][1].pose
        assert matrix(pose.position, pose.orientation) == pytest.approx(ego_frame(index).odom_from_vehicle)


def test_an_obstacle_hangs_below_the_road_until_it_is_gone(messages: dict[str, list]) -> None:
    (first_ns, first), (grown_ns, _), (_, gone) = messages["/obstacles"]
    cube = first.entities[0].cubes[0]
    assert first_ns == header().start_ns
    assert grown_ns == header().start_ns + 200_000_000
    assert (cube.size.x, cube.size.y, cube.size.z) == (0.9, 0.7, 0.1)
    assert cube.pose.position.z == pytest.approx(obstacle().enu_m[2] - 0.05)
    assert [d.id for d in gone.deletions] == ["1"]


def test_the_recording_is_described_in_the_file(path: Path) -> None:
    with path.open("rb") as stream:
        (metadata,) = make_reader(stream).iter_metadata()
    assert json.loads(metadata.metadata["recording"])["seed"] == 5
