"""MCAP files as message logs: Foxglove's schemas, our own, and ROS 2."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from vehicle_client.frames import yaw_of
from vehicle_client.sources.complaints import Complaints
from vehicle_client.sources.foxglove_readings import DECODERS
from vehicle_client.sources.frame import SourceError
from vehicle_client.sources.mcap_records import McapRecords
from vehicle_client.sources.mounting import Lever
from vehicle_client.sources.recorded_tables import parse_description
from vehicle_client.sources.ros_readings import RosTypes
from vehicle_client.sources.topics import Decode, Role, Topic


class McapLog:
    """One file; `SourceError` if it is no MCAP file."""

    def __init__(self, path: Path, complaints: Complaints) -> None:
        self._records = McapRecords(path, complaints)
        self._ros = RosTypes(2)
        self.topics: list[Topic] = []
        self.others: list[str] = []
        self._channels: dict[int, str] = {}
        index = self._records.index
        self.lever = _lever(index.description, path)
        for channel in sorted(index.channels.values(), key=lambda c: c.id):
            schema = index.schemas.get(channel.schema_id)
            kind = schema.name if schema else ""
            found = self._decoder(channel.message_encoding, channel.topic, kind)
            count = index.counts.get(channel.id, 0) if index.counts else None
            if found is None:
                self.others.append(f"{channel.topic} ({kind}, {channel.message_encoding})")
            else:
                self._channels[channel.id] = channel.topic
                self._add(Topic(channel.topic, kind, *found, count))

    def messages(self, names: frozenset[str]) -> Iterator[tuple[int, str, bytes]]:
        """Log time (Unix, nanoseconds), topic and bytes of every message of these topics."""
        wanted = frozenset(number for number, topic in self._channels.items() if topic in names)
        for message in self._records.messages(wanted):
            yield message.log_time_ns, self._channels[message.channel_id], message.data

    def _decoder(self, encoding: str, topic: str, kind: str) -> tuple[Role, Decode] | None:
        return self._ros.decoder(topic, kind) if encoding == "cdr" else DECODERS.get((encoding, kind))

    def _add(self, topic: Topic) -> None:
        """A topic, or one more channel of it: recordings of several publishers have one each."""
        for index, known in enumerate(self.topics):
            if known.name == topic.name:
                counted = (known.messages or 0) + (topic.messages or 0)
                self.topics[index] = Topic(known.name, known.type, known.role, known.decode, counted)
                return
        self.topics.append(topic)


class McapLogs:
    """Several files one after the other, as ROS 2 splits a bag."""

    def __init__(self, paths: Sequence[Path], complaints: Complaints) -> None:
        self._logs, errors = [], []
        for path in paths:
            try:
                self._logs.append(McapLog(path, complaints))
            except SourceError as error:
                complaints.add(str(error))
                errors.append(str(error))
        if not self._logs:
            raise SourceError(f"{paths[0].parent}: none of its {len(paths)} MCAP files can be read: {errors[0]}")
        self.lever = self._logs[0].lever
        self.others = sorted({other for log in self._logs for other in log.others})

    @property
    def topics(self) -> list[Topic]:
        """Those of all files, with the messages of all."""
        found: dict[str, Topic] = {}
        for topic in (topic for log in self._logs for topic in log.topics):
            before = found.get(topic.name)
            counted = (before.messages or 0 if before else 0) + (topic.messages or 0)
            found[topic.name] = Topic(topic.name, topic.type, topic.role, topic.decode, counted)
        return list(found.values())

    def messages(self, names: frozenset[str]) -> Iterator[tuple[int, str, bytes]]:
        """Log time (Unix, nanoseconds), topic and bytes of every message of these topics."""
        for log in self._logs:
            yield from log.messages(names)


def _lever(description: str | None, path: Path) -> Lever:
    """Where our simulator's description of a recording puts the first receiver and inertial unit."""
    if description is None:
        return Lever()
    said = parse_description(description, path)
    antenna, imu = said.first("sensor.other.gnss"), said.first("sensor.other.imu")
    return Lever(antenna[:3, 3], yaw_of(imu))
