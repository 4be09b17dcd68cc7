"""One vehicle's recording as an MCAP file (https://mcap.dev/spec) with Foxglove's schemas, for Foxglove and ROS tools.

Topics: a cloud or picture under its folder's name, `/gnss`, `/imu`, `/pose`, `/odometry`, `/vehicle`,
`/tf`, `/obstacles`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import Message
from mcap.writer import CompressionType, Writer

from simulator.readings import (
    EgoFrame,
    GnssReading,
    ImageReading,
    ImuReading,
    LidarReading,
    ObstacleTruth,
    Reading,
    SensorName,
)
from simulator.recording import foxglove_messages as messages
from simulator.recording.files import jpeg_bytes
from simulator.recording.header import RecordingHeader

LIBRARY = "headsup"
"""Stands in the file in place of the library's version, so that an update does not change the bytes."""

CHUNK_BYTES = 4_000_000
"""About a turn of a dense LiDAR: players read a chunk at a time."""


class McapFile:
    """Writes frames of one vehicle; the file has its name only once it is closed."""

    def __init__(
        self,
        path: Path,
        header: RecordingHeader,
        folders: Mapping[SensorName, str],
        obstacles: Sequence[ObstacleTruth] = (),
    ) -> None:
        self._path = path
        self._part = path.with_name(path.name + ".part")
        self._header = header
        self._folders = folders
        self._sensors = dict(zip(folders, header.sensors, strict=True))
        self._stream = self._part.open("wb")
        self._writer = Writer(self._stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library=LIBRARY)
        self._writer.add_metadata("headsup", {"recording": json.dumps(header.as_json())})
        self._channels: dict[str, int] = {}
        self._sequence: dict[int, int] = {}
        for row in obstacles:
            time_ns = self._time_ns(row.from_s)
            self._put("/obstacles", time_ns, messages.obstacle_scene(time_ns, row))

    def write(self, frame: EgoFrame, pictures: Mapping[SensorName, bytes]) -> None:
        """Write the messages of a frame; `pictures` holds the PNG of every image reading."""
        time_ns = self._time_ns(frame.time_s)
        self._put("/tf", time_ns, FrameTransforms(transforms=self._transforms(time_ns, frame)))
        self._put("/pose", time_ns, messages.pose_in_frame(time_ns, "enu", frame.enu_from_vehicle))
        self._put("/odometry", time_ns, messages.odometry(time_ns, frame.odom_from_vehicle))
        state = {"speed_mps": frame.speed_mps, "steering_rad": frame.steering_rad, "frame": frame.number}
        self._put_json("/vehicle", time_ns, messages.VEHICLE_SCHEMA, state)
        for reading in frame.readings:
            self._put_reading(time_ns, reading, pictures)

    def close(self) -> None:
        """Finish the file and give it its name."""
        self._writer.finish()  # type: ignore[no-untyped-call]  # mcap leaves this one function untyped
        self._stream.close()
        self._part.replace(self._path)

    def abandon(self) -> None:
        """Leave the unfinished file under its temporary name."""
        self._stream.close()

    def _put_reading(self, time_ns: int, reading: Reading, pictures: Mapping[SensorName, bytes]) -> None:
        folder = self._folders[reading.sensor]
        role = folder.removeprefix(reading.sensor.type).replace(".", "/")
        match reading:
            case LidarReading():
                self._put(f"/{folder}", time_ns, messages.point_cloud(time_ns, folder, reading.sweep))
            case ImageReading():
                optical, sensor = f"{folder}.optical", self._sensors[reading.sensor]
                calibration = messages.camera_calibration(time_ns, optical, reading, sensor)
                # Tags must survive; colours are kept whole as PNG beside the MCAP, and here five times smaller.
                coloured = reading.pixels.ndim == 3
                data = jpeg_bytes(reading.pixels) if coloured else pictures[reading.sensor]
                image = messages.compressed_image(time_ns, optical, data, "jpeg" if coloured else "png")
                self._put(f"/{folder}", time_ns, image)
                self._put(f"/{folder}/calibration", time_ns, calibration)
            case GnssReading():
                own_ns = self._time_ns(reading.time_s)
                self._put(f"/gnss{role}", own_ns, messages.location_fix(own_ns, folder, reading))
            case ImuReading():
                own_ns = self._time_ns(reading.time_s)
                self._put_json(f"/imu{role}", own_ns, messages.IMU_SCHEMA, messages.imu_json(reading))

    def _transforms(self, time_ns: int, frame: EgoFrame) -> list[Any]:
        vehicle_from_street = np.linalg.inv(frame.street_from_vehicle)
        transforms = [
            messages.frame_transform(time_ns, "enu", "street", self._header.enu_from_street),
            messages.frame_transform(time_ns, "street", "vehicle", frame.street_from_vehicle),
        ]
        for reading in frame.readings:
            if isinstance(reading, LidarReading | ImageReading):
                folder = self._folders[reading.sensor]
                mounting = vehicle_from_street @ reading.street_from_sensor
                transforms.append(messages.frame_transform(time_ns, "vehicle", folder, mounting))
            if isinstance(reading, ImageReading):
                optical = messages.CAMERA_FROM_OPTICAL
                transforms.append(messages.frame_transform(time_ns, folder, f"{folder}.optical", optical))
        return transforms

    def _time_ns(self, time_s: float) -> int:
        return self._header.start_ns + round(time_s * 1e9)

    def _put(self, topic: str, time_ns: int, message: Message) -> None:
        if topic not in self._channels:
            name = message.DESCRIPTOR.full_name
            schema = self._writer.register_schema(name, "protobuf", _descriptors(message.DESCRIPTOR.file))
            self._channels[topic] = self._writer.register_channel(topic, "protobuf", schema)
        self._add(topic, time_ns, message.SerializeToString(deterministic=True))

    def _put_json(self, topic: str, time_ns: int, schema: Mapping[str, object], value: Mapping[str, object]) -> None:
        if topic not in self._channels:
            schema_id = self._writer.register_schema(str(schema["title"]), "jsonschema", json.dumps(schema).encode())
            self._channels[topic] = self._writer.register_channel(topic, "json", schema_id)
        self._add(topic, time_ns, json.dumps(value, allow_nan=False).encode())

    def _add(self, topic: str, time_ns: int, data: bytes) -> None:
        channel = self._channels[topic]
        sequence = self._sequence[channel] = self._sequence.get(channel, -1) + 1
        self._writer.add_message(channel, log_time=time_ns, data=data, publish_time=time_ns, sequence=sequence)


def _descriptors(file: FileDescriptor) -> bytes:
    """The message's file and all it imports, dependencies first: what MCAP wants as a protobuf schema."""
    found: dict[str, FileDescriptor] = {}

    def visit(one: FileDescriptor) -> None:
        if one.name not in found:
            for dependency in one.dependencies:
                visit(dependency)
            found[one.name] = one

    visit(file)
    files = FileDescriptorSet()
    for one in found.values():
        one.CopyToProto(files.file.add())
    return bytes(files.SerializeToString(deterministic=True))
