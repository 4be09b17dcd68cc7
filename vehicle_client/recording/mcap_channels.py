"""Messages by topic into an MCAP file (https://mcap.dev/spec); a topic's schema is written with its first message."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import BinaryIO

from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import Message
from mcap.writer import CompressionType, Writer

LIBRARY = "headsup"
"""Stands in the file in place of the library's version, so that an update does not change the bytes."""

CHUNK_BYTES = 4_000_000
"""About two turns of a dense LiDAR: so much a power cut loses."""


class McapChannels:
    """Writes protobuf and JSON messages; the same messages give the same bytes."""

    def __init__(self, stream: BinaryIO, metadata: Mapping[str, str]) -> None:
        self._writer = Writer(stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library=LIBRARY)
        self._writer.add_metadata("headsup.drive", dict(metadata))
        self._channels: dict[str, int] = {}
        self._sequence: dict[int, int] = {}

    def put(self, topic: str, time_ns: int, message: Message) -> None:
        """A protobuf message, at a Unix time in nanoseconds."""
        if topic not in self._channels:
            name = message.DESCRIPTOR.full_name
            schema = self._writer.register_schema(name, "protobuf", _descriptors(message.DESCRIPTOR.file))
            self._channels[topic] = self._writer.register_channel(topic, "protobuf", schema)
        self._add(topic, time_ns, message.SerializeToString(deterministic=True))

    def put_json(self, topic: str, time_ns: int, title: str, value: Mapping[str, object]) -> None:
        """A JSON object whose schema is called `title`."""
        if topic not in self._channels:
            schema = json.dumps({"title": title, "type": "object"}).encode()
            schema_id = self._writer.register_schema(title, "jsonschema", schema)
            self._channels[topic] = self._writer.register_channel(topic, "json", schema_id)
        self._add(topic, time_ns, json.dumps(value, allow_nan=False).encode())

    def finish(self) -> None:
        """Write what is left and the summary."""
        self._writer.finish()  # type: ignore[no-untyped-call]  # mcap leaves this one function untyped

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
