"""Messages of an MCAP file (https://mcap.dev/spec), also of one that ends early or has corrupt chunks.

The library's own reader gives up at the first record that makes no sense, and decompresses whatever a chunk announces.
"""

from __future__ import annotations

import heapq
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import zstandard
from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, Footer, MessageIndex, Metadata, MetadataIndex, Schema, Statistics

from vehicle_client.sources.complaints import Complaints
from vehicle_client.sources.frame import SourceError

MAGIC = b"\x89MCAP0\r\n"
FOOTER_BYTES = 9 + 20 + len(MAGIC)

OWN_METADATA = "headsup"

LARGEST_RECORD = 256 * 2**20
"""Writers cut chunks at some megabytes; a sweep or a raw picture has no more than some tens of them."""

CHUNKS_TO_TRY = 20
"""Chunks of a file without a summary in which the channels are looked for: each names those of its messages."""

MESSAGE_HEAD = 22
"""Channel, sequence, log time and publish time."""

SENSELESS = (struct.error, ValueError, OverflowError, McapError, zstandard.ZstdError, RuntimeError, MemoryError)
"""What parsers and decompressors raise where bytes make no sense."""


@dataclass(frozen=True, slots=True)
class RawMessage:
    """A message as it was written, Unix time in nanoseconds."""

    log_time_ns: int
    channel_id: int
    data: bytes


@dataclass(slots=True)
class McapIndex:
    """What a file holds: channels and schemas by id, messages by channel, and where its chunks begin.

    `chunks` are (first message's time in nanoseconds, place); None where there is no summary: then the file is walked
    from its start.
    """

    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    chunks: list[tuple[int, int]] | None = None
    metadata_at: int | None = None
    description: str | None = None
    """`recording` of our own metadata: what recording.json of a run folder says."""


class McapRecords:
    """The records of one file; `SourceError` if it is no MCAP file."""

    def __init__(self, path: Path, complaints: Complaints) -> None:
        self._path, self._complaints = path, complaints
        self._bytes = path.stat().st_size
        with path.open("rb") as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                raise SourceError(f"{path}: expected an MCAP file, which begins with {MAGIC!r}")
            self.index = self._summary(stream) or self._walked_index(stream)

    def messages(self, channels: frozenset[int]) -> Iterator[RawMessage]:
        """The messages of these channels by their log time, as far as chunks do not overlap by more than the next.

        Where a clock was set back all that comes before would have to wait; no more than `LARGEST_RECORD` bytes do.
        """
        waiting: list[tuple[int, int, RawMessage]] = []
        order = size = 0
        with self._path.open("rb") as stream:
            for begins_ns, messages in self._groups(stream):
                while waiting and (waiting[0][0] < begins_ns or size > LARGEST_RECORD):
                    message = heapq.heappop(waiting)[2]
                    size -= len(message.data)
                    yield message
                for message in messages:
                    if message.channel_id in channels:
                        heapq.heappush(waiting, (message.log_time_ns, order, message))
                        order, size = order + 1, size + len(message.data)
        while waiting:
            yield heapq.heappop(waiting)[2]

    def _groups(self, stream: BinaryIO) -> Iterator[tuple[int, list[RawMessage]]]:
        """The messages of a chunk, and its first time; a message outside of chunks is a group of its own."""
        for opcode, at, length in self._positions(stream):
            stream.seek(at)
            content = stream.read(length)
            try:
                if opcode == Opcode.CHUNK:
                    chunk = _chunk(content)
                    yield chunk.message_start_time, list(_chunk_messages(_unpacked(chunk)))
                elif opcode == Opcode.MESSAGE:
                    message = _message(memoryview(content))
                    yield message.log_time_ns, [message]
            except SENSELESS as error:
                self._complaints.add(f"{self._path}: a corrupt record at byte {at} is left out: {error}")

    def _positions(self, stream: BinaryIO) -> Iterator[tuple[int, int, int]]:
        """Opcode, place and length of every record with messages in it."""
        if self.index.chunks is None:
            yield from (r for r in self._walk(stream, self._complaints) if r[0] in (Opcode.CHUNK, Opcode.MESSAGE))
            return
        for _, start in self.index.chunks:
            stream.seek(start)
            opcode, length = _record_head(stream.read(9))
            if opcode == Opcode.CHUNK and length <= min(LARGEST_RECORD, self._bytes - start - 9):
                yield opcode, start + 9, length
            else:
                self._complaints.add(f"{self._path}: no chunk at byte {start}, where the summary says one is")

    def _walk(self, stream: BinaryIO, complaints: Complaints | None = None) -> Iterator[tuple[int, int, int]]:
        """Opcode, place and length of every record up to the end of the data, or to where the file is cut."""
        at = len(MAGIC)
        while True:
            stream.seek(at)
            opcode, length = _record_head(stream.read(9))
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                return
            if opcode == 0 or length > min(LARGEST_RECORD, self._bytes - at - 9):
                if complaints is not None:
                    complaints.add(f"{self._path}: ends within a record, at byte {at} of {self._bytes}")
                return
            yield opcode, at + 9, length
            at += 9 + length

    def _summary(self, stream: BinaryIO) -> McapIndex | None:
        """The summary at the end of a file that was finished; None if it is missing, corrupt or knows no chunks."""
        try:
            stream.seek(max(0, self._bytes - FOOTER_BYTES))
            tail = stream.read()
            opcode, _ = _record_head(tail)
            footer = Footer.read(_stream(tail[9:]))
            start, length = footer.summary_start, self._bytes - FOOTER_BYTES - footer.summary_start
            if opcode != Opcode.FOOTER or not tail.endswith(MAGIC) or start == 0 or not 0 < length < LARGEST_RECORD:
                return None
            stream.seek(start)
            summary = stream.read(length)
            # The checksum goes on over the footer, up to itself.
            if footer.summary_crc not in (0, zlib.crc32(summary + tail[: 9 + 16])):
                return None
            index = _read_summary(summary)
            if index is not None and index.metadata_at is not None:
                stream.seek(index.metadata_at)
                opcode, length = _record_head(stream.read(9))
                _add_to(index, opcode, stream.read(min(length, LARGEST_RECORD)))
            return index
        except SENSELESS:
            return None

    def _walked_index(self, stream: BinaryIO) -> McapIndex:
        """Channels and counts without a summary: from the first chunks, and the message indexes that follow each."""
        index, chunks = McapIndex(), 0
        for opcode, at, length in self._walk(stream):
            if opcode == Opcode.CHUNK and chunks >= CHUNKS_TO_TRY:
                continue
            chunks += opcode == Opcode.CHUNK
            stream.seek(at)
            try:
                _add_to(index, opcode, stream.read(length))
            except SENSELESS:
                continue  # complained of when its messages are read
        return index


def _add_to(index: McapIndex, opcode: int, content: bytes) -> None:
    match opcode:
        case Opcode.CHANNEL:
            channel = Channel.read(_stream(content))
            index.channels[channel.id] = channel
        case Opcode.SCHEMA:
            schema = Schema.read(_stream(content))
            index.schemas[schema.id] = schema
        case Opcode.STATISTICS:
            index.counts.update(Statistics.read(_stream(content)).channel_message_counts)
        case Opcode.CHUNK_INDEX:
            chunk = ChunkIndex.read(_stream(content))
            index.chunks = index.chunks or []
            index.chunks.append((chunk.message_start_time, chunk.chunk_start_offset))
        case Opcode.METADATA:
            metadata = Metadata.read(_stream(content))
            if metadata.name == OWN_METADATA:
                index.description = metadata.metadata.get("recording")
        case Opcode.METADATA_INDEX:
            entry = MetadataIndex.read(_stream(content))
            index.metadata_at = entry.offset if entry.name == OWN_METADATA else index.metadata_at
        case Opcode.MESSAGE_INDEX:
            entries = MessageIndex.read(_stream(content))
            index.counts[entries.channel_id] += len(entries.records)
        case Opcode.MESSAGE:
            index.counts[_message(memoryview(content)).channel_id] += 1
        case Opcode.CHUNK:
            for inner, record in _records(_unpacked(_chunk(content))):
                if inner in (Opcode.CHANNEL, Opcode.SCHEMA):
                    _add_to(index, inner, bytes(record))


def _read_summary(summary: bytes) -> McapIndex | None:
    index = McapIndex()
    for opcode, record in _records(summary):
        _add_to(index, opcode, bytes(record))
    if index.chunks is None or not index.channels:
        return None
    index.chunks.sort()
    return index


def _records(data: bytes) -> Iterator[tuple[int, memoryview]]:
    view, at = memoryview(data), 0
    while at < len(view):
        opcode, length = _record_head(view[at : at + 9])
        if length > len(view) - at - 9:
            raise ValueError("a record is longer than what holds it")
        yield opcode, view[at + 9 : at + 9 + length]
        at += 9 + length


def _chunk_messages(data: bytes) -> Iterator[RawMessage]:
    for opcode, record in _records(data):
        if opcode == Opcode.MESSAGE:
            yield _message(record)


def _message(record: memoryview) -> RawMessage:
    channel_id, _sequence, log_time_ns = struct.unpack_from("<HIQ", record)
    if len(record) < MESSAGE_HEAD:
        raise ValueError("a message without its head")
    return RawMessage(log_time_ns, channel_id, bytes(record[MESSAGE_HEAD:]))


def _chunk(content: bytes) -> Chunk:
    chunk: Chunk = Chunk.read(_stream(content))
    if chunk.uncompressed_size > LARGEST_RECORD:
        raise ValueError(f"a chunk announces {chunk.uncompressed_size} bytes")
    return chunk


def _unpacked(chunk: Chunk) -> bytes:
    """The records of a chunk, no more of them than it announces, checked by their checksum."""
    size = chunk.uncompressed_size
    match chunk.compression:
        case "":
            data = bytes(chunk.data)
        case "zstd":
            with zstandard.ZstdDecompressor(max_window_size=LARGEST_RECORD).stream_reader(chunk.data) as reader:
                data = reader.read(size + 1)
        case "lz4":
            data = bytes(LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1))
        case _:
            raise ValueError(f"unknown compression {chunk.compression!r}")
    if len(data) != size:
        raise ValueError(f"a chunk of {size} bytes unpacks to {len(data)}")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("a chunk's checksum is wrong")
    return data


def _record_head(data: bytes | memoryview) -> tuple[int, int]:
    """Opcode and length of a record; opcode 0, which none has, at the end of the file."""
    return struct.unpack("<BQ", data[:9]) if len(data) >= 9 else (0, 0)


def _stream(content: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(content))
