"""Messages put together again from their parts, with a bound on what waits: anyone may send datagrams."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from typing import Any

from vehicle_client.sources.complaints import Complaints
from vehicle_client.sources.live_message import HEADER, LARGEST_PAYLOAD, Head, parse_head

MOST_WAITING = 8
"""Messages that are not whole yet: a sweep, a picture and what is late."""

Key = tuple[Any, int, int]
"""Sender, kind and number of a message."""


@dataclass(slots=True)
class _Waiting:
    head: Head
    pieces: dict[int, bytes] = field(default_factory=dict)
    size: int = 0


@dataclass(slots=True)
class Parts:
    """Takes datagrams and gives whole messages; what lost a part is left out and counted."""

    complaints: Complaints
    _waiting: dict[Key, _Waiting] = field(default_factory=dict, init=False)
    _done: dict[tuple[Any, int], int] = field(default_factory=dict, init=False)
    _size: int = field(default=0, init=False)

    def add(self, sender: Any, datagram: bytes) -> tuple[Head, bytes] | None:
        """The message that a datagram made whole: a header of it, and its payload."""
        head = parse_head(datagram)
        if head is None or head.length != len(datagram) - HEADER.size:
            self.complaints.add(f"a datagram of {len(datagram)} bytes from {sender} has no header that makes sense")
            return None
        piece = datagram[HEADER.size :]
        if zlib.crc32(piece) != head.crc:
            self.complaints.add(f"part {head.part} of message {head.message} from {sender} is corrupt")
            return None
        if head.parts == 1:
            return head, piece
        return self._joined((sender, head.kind, head.message), head, piece)

    def _joined(self, key: Key, head: Head, piece: bytes) -> tuple[Head, bytes] | None:
        if not _is_after(head.message, self._done.get(key[:2])):
            return None  # a part that came twice, or too late
        waiting = self._waiting.setdefault(key, _Waiting(head))
        if waiting.head.parts != head.parts or waiting.head.stamp_ns != head.stamp_ns:
            self._drop(key, "its parts contradict each other")
            return None
        if head.part not in waiting.pieces:
            waiting.pieces[head.part] = piece
            waiting.size += len(piece)
            self._size += len(piece)
        if len(waiting.pieces) == head.parts:
            return self._finished(key)
        while len(self._waiting) > MOST_WAITING or self._size > LARGEST_PAYLOAD:
            self._drop(next(iter(self._waiting)), "the others did not come")
        return None

    def _finished(self, key: Key) -> tuple[Head, bytes]:
        whole = self._waiting.pop(key)
        self._size -= whole.size
        if len(self._done) >= MOST_WAITING:
            self._done.clear()
        self._done[key[:2]] = key[2]
        # Parts of one sender come in order but for a few: what began before this message lost some.
        for other in [k for k in self._waiting if k[:2] == key[:2] and not _is_after(k[2], key[2])]:
            self._drop(other, "the others did not come")
        return whole.head, b"".join(whole.pieces[part] for part in range(whole.head.parts))

    def _drop(self, key: Key, reason: str) -> None:
        lost = self._waiting.pop(key)
        self._size -= lost.size
        self.complaints.add(f"message {key[2]} has {len(lost.pieces)} of {lost.head.parts} parts: {reason}")


def _is_after(message: int, done: int | None) -> bool:
    """Whether a number follows another, of those that count up to 2**32 and begin again."""
    return done is None or 0 < (message - done) % 2**32 < 2**31
