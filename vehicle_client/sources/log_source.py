"""A drive from a log of messages by topic, whatever file holds them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Protocol

from vehicle_client.sources.assembling import Assembler
from vehicle_client.sources.complaints import Complaints
from vehicle_client.sources.frame import LidarFrame, SourceError
from vehicle_client.sources.mounting import Lever
from vehicle_client.sources.readings import Reading
from vehicle_client.sources.topics import Role, Topic, choose


class MessageLog(Protocol):
    """A recording of messages: topics that can be read, names and types of the others, messages by log time."""

    @property
    def topics(self) -> Sequence[Topic]:
        """Those whose type can be read."""
        ...

    @property
    def others(self) -> Sequence[str]:
        """`name (type)` of those whose type cannot."""
        ...

    @property
    def lever(self) -> Lever:
        """Where the receiver and the inertial unit sit, if the recording says so."""
        ...

    def messages(self, names: frozenset[str]) -> Iterator[tuple[int, str, bytes]]:
        """Log time (Unix, nanoseconds), topic and bytes of every message of these topics."""
        ...


class LogSource:
    """The drive of a message log; `asked` names topics by role (`vehicle_client.sources.topics.Role`).

    `SourceError` if the log holds no point clouds, or several topics that cannot be told apart.
    """

    def __init__(self, log: MessageLog, place: object, asked: Mapping[str, str], complaints: Complaints) -> None:
        self._log, self._place, self._complaints = log, place, complaints
        self._topics = {topic.name: topic for topic in choose(log.topics, asked, place, log.others)}
        self._sweeps = next(topic for topic in self._topics.values() if topic.role is Role.SWEEP)

    @property
    def topics(self) -> dict[str, str]:
        """What was chosen: topic by role."""
        return {topic.role.value: topic.name for topic in self._topics.values()}

    @property
    def skipped(self) -> int:
        """How many messages could not be used so far."""
        return self._complaints.count

    def __len__(self) -> int:
        """Sweeps that were recorded, also those that turn out to be corrupt; 0 where nobody counted."""
        return self._sweeps.messages or 0

    def __iter__(self) -> Iterator[LidarFrame]:
        return Assembler(self._complaints, self._log.lever).frames(self._readings())

    def _readings(self) -> Iterator[Reading]:
        for log_ns, name, data in self._sweeps_last(self._log.messages(frozenset(self._topics))):
            yield from self._decoded(self._topics[name], log_ns / 1e9, data)

    def _sweeps_last(self, messages: Iterator[tuple[int, str, bytes]]) -> Iterator[tuple[int, str, bytes]]:
        """What else was said at a sweep's moment belongs to it, in whichever order it was written."""
        held: tuple[int, str, bytes] | None = None
        for message in messages:
            is_sweep = message[1] == self._sweeps.name
            if held is not None and (is_sweep or message[0] != held[0]):
                yield held
                held = None
            if is_sweep:
                held = message
            else:
                yield message
        if held is not None:
            yield held

    def _decoded(self, topic: Topic, log_s: float, data: bytes) -> Sequence[Reading]:
        try:
            return topic.decode(log_s, data)
        except SourceError as error:
            self._complaints.add(f"{self._place}: a message of {topic.name} is left out: {error}")
            return ()
