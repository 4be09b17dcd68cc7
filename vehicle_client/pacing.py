"""Frames at the pace of the road: one thread reads, one prepares, the drive takes them; what is late is dropped whole.

At the sensor's pace a queue holds the latest frames, and the oldest is dropped and counted when nobody has taken it;
its fixes and motions go to the next. At the drive's pace (a recording that nobody waits for) queues fill and reading
waits: nothing is dropped.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

from vehicle_client.faults import Faults
from vehicle_client.sources.frame import LidarFrame, inheriting

T = TypeVar("T")

MOST_WAITING = 2
"""Frames between two threads: one that is waited for, and one more against jitter; each costs its age."""

MOST_BEHIND_S = 0.5
"""A recording that is read later than this comes from a slow disk, or another program has the processor: no sensor
would have waited."""

_LOOK_S = 0.2
"""How often a thread that waits looks whether the drive has ended."""


@dataclass(frozen=True, slots=True)
class _Read:
    frame: LidarFrame
    complete_s: float


@dataclass(frozen=True, slots=True)
class Ready(Generic[T]):
    """A prepared frame with what its preparation knows besides, and when its sweep was complete (monotonic clock)."""

    frame: LidarFrame
    known: T
    complete_s: float


def _read_after(read: _Read, dropped: _Read) -> _Read:
    return replace(read, frame=inheriting(read.frame, dropped.frame))


def _ready_after(ready: Ready[T], dropped: Ready[T]) -> Ready[T]:
    return replace(ready, frame=inheriting(ready.frame, dropped.frame))


class Queue(Generic[T]):
    """Between two threads, for at most `MOST_WAITING` items.

    Full, it drops its oldest, and the next becomes what `inheriting` makes of it and the dropped one; without
    `inheriting` the giver waits.
    """

    def __init__(self, inheriting: Callable[[T, T], T] | None) -> None:
        self._items: deque[T] = deque()
        self._inheriting = inheriting
        self._changed = threading.Condition()
        self._error: BaseException | None = None
        self._has_ended = self._is_closed = False
        self.dropped = 0

    def put(self, item: T) -> None:
        """Give an item, waiting for room unless the queue drops, or is closed."""
        with self._changed:
            if self._inheriting is not None and len(self._items) >= MOST_WAITING:
                dropped = self._items.popleft()
                self._items[0] = self._inheriting(self._items[0], dropped)
                self.dropped += 1
            while len(self._items) >= MOST_WAITING and not self._is_closed:
                self._changed.wait(_LOOK_S)
            self._items.append(item)
            self._changed.notify_all()

    def end(self, error: BaseException | None = None) -> None:
        """No more items come; whoever takes beyond the last one gets the error, if there was one."""
        with self._changed:
            self._has_ended, self._error = True, error
            self._changed.notify_all()

    def close(self) -> None:
        """Nobody takes any more. Takes no lock, since a signal's handler may call it; those who wait look soon."""
        self._is_closed = True

    def __iter__(self) -> Iterator[T]:
        while True:
            with self._changed:
                while not self._items and not self._has_ended and not self._is_closed:
                    self._changed.wait(_LOOK_S)
                if self._is_closed:
                    return
                if not self._items:
                    if self._error is not None:
                        raise self._error
                    return
                item = self._items.popleft()
                self._changed.notify_all()
            yield item


class Paced(Generic[T]):
    """The frames of a source, prepared, as a context manager: its threads end with the block.

    `prepare` is called once for each frame, in their order, by one thread; a frame in which it fails is left out and
    counted in `faults`. `realtime` keeps the sensor's pace;
    `is_recorded` then holds each frame back until as long after the first one as its stamp says.
    """

    def __init__(
        self,
        source: Iterable[LidarFrame],
        prepare: Callable[[LidarFrame], tuple[LidarFrame, T]],
        *,
        realtime: bool,
        is_recorded: bool,
    ) -> None:
        self._source, self._prepare = source, prepare
        self._is_held = realtime and is_recorded
        self.stalls = 0
        """How often a recording was read more slowly than it was made, and its clock set anew."""
        self.faults = Faults()
        self._read: Queue[_Read] = Queue(_read_after if realtime else None)
        self._ready: Queue[Ready[T]] = Queue(_ready_after if realtime else None)
        self._ends = threading.Event()
        self._threads = [
            threading.Thread(target=work, name=name, daemon=True)
            for name, work in (("headsup-reading", self._reading), ("headsup-preparing", self._preparing))
        ]

    def __enter__(self) -> Paced[T]:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        for thread in self._threads:
            # A live source may wait for its sensor; it is a daemon's thread and holds nothing that must be put away.
            thread.join(timeout=1.0)

    def stop(self) -> None:
        """No more frames come; whoever takes them has the last one. Harmless from a signal handler."""
        self._ends.set()
        self._read.close()
        self._ready.close()

    @property
    def dropped(self) -> int:
        """Frames that nobody took in time."""
        return self._read.dropped + self._ready.dropped

    def __iter__(self) -> Iterator[Ready[T]]:
        return iter(self._ready)

    def _reading(self) -> None:
        try:
            begun: tuple[float, float] | None = None
            for frame in self._source:
                now_s = time.monotonic()
                if begun is None or now_s - begun[0] - (frame.stamp_s - begun[1]) > MOST_BEHIND_S:
                    self.stalls += begun is not None and self._is_held
                    begun = now_s, frame.stamp_s
                due_s = begun[0] + frame.stamp_s - begun[1] if self._is_held else now_s
                if due_s > now_s:
                    self._ends.wait(due_s - now_s)
                if self._ends.is_set():
                    return
                # Reading that is late does not make the sweep younger.
                self._read.put(_Read(frame, min(due_s, time.monotonic())))
        except Exception as error:  # told to whoever takes the frames
            self._read.end(error)
        else:
            self._read.end()

    def _preparing(self) -> None:
        try:
            for read in self._read:
                try:
                    prepared, known = self._prepare(read.frame)
                except Exception as error:  # a fault in one frame ends no drive; too many in a row are raised
                    self.faults.add(error)
                    continue
                self.faults.end_row()
                self._ready.put(Ready(prepared, known, read.complete_s))
        except Exception as error:  # told to whoever takes the frames
            self._ready.end(error)
        else:
            self._ready.end()
