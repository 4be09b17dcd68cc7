"""ROS bags as message logs, by the library rosbags: ROS 1 files, and ROS 2 in SQLite."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import rosbags.rosbag1
import rosbags.rosbag2
from rosbags.interfaces import Connection

from vehicle_client.sources.complaints import Complaints
from vehicle_client.sources.frame import SourceError
from vehicle_client.sources.mounting import Lever
from vehicle_client.sources.ros_readings import RosTypes
from vehicle_client.sources.topics import Topic

Reader = rosbags.rosbag1.Reader | rosbags.rosbag2.Reader


class RosBag:
    """A `.bag` file (generation 1), or a folder or `.db3` file (generation 2); `SourceError` if it cannot be opened."""

    def __init__(self, path: Path, generation: int, complaints: Complaints) -> None:
        self._path, self._generation, self._complaints = path, generation, complaints
        self.lever = Lever()
        types = RosTypes(generation)
        self.topics: list[Topic] = []
        self.others: list[str] = []
        try:
            with self._reader() as reader:
                said = [(name, info.msgtype or "", info.msgcount) for name, info in sorted(reader.topics.items())]
        except Exception as error:  # the library and its decompressors raise a dozen types where bytes make no sense
            raise SourceError(f"{path}: expected a whole ROS {generation} bag: {error}") from error
        for name, kind, count in said:
            found = types.decoder(name, kind)
            if found is None:
                self.others.append(f"{name} ({kind})")
            else:
                self.topics.append(Topic(name, kind, *found, count))

    def messages(self, names: frozenset[str]) -> Iterator[tuple[int, str, bytes]]:
        """Log time (Unix, nanoseconds), topic and bytes; up to where the bag is corrupt, which is said."""
        try:
            with self._reader() as reader:
                wanted: Sequence[Connection] = [c for c in reader.connections if c.topic in names]
                for connection, log_ns, data in reader.messages(wanted):
                    yield log_ns, connection.topic, bytes(data)
        except Exception as error:
            self._complaints.add(f"{self._path}: cannot be read any further: {error}")

    def _reader(self) -> Reader:
        return rosbags.rosbag1.Reader(self._path) if self._generation == 1 else rosbags.rosbag2.Reader(self._path)
