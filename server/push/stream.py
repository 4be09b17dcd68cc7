"""Push: each WebSocket has a moving area; what appears, changes, leaves or goes there is sent, the latest of each.

A connection's queue holds at most one event for an obstacle and a bounded number in all; a vehicle that falls behind
is resynchronised by a snapshot, and delays nobody.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from uuid import UUID

from contract.events import Appeared, Left, Moved, Position, Removed, ServerMessage, Snapshot, Updated
from contract.geometry import LatLon
from contract.obstacle import ObstacleFeature
from server.counters import PushCounts
from server.geometry.geodesy import is_within
from server.storage.features import ObstacleEvent

# Obstacles leave the area later than they enter it, so that none flickers at the edge.
LEAVING_RATIO = 1.2
# More changes than a busy city street has within 2 km while a packet is lost.
_QUEUE_LIMIT = 256
# Events of some ten seconds at full load: the log tells each once more within one.
_REMEMBERED = 65_536

Near = Callable[[LatLon, float], Awaitable[tuple[ObstacleFeature, ...]]]
Send = Callable[[ServerMessage], Awaitable[None]]


class Hub:
    """All connections of this process."""

    def __init__(self) -> None:
        self._subscriptions: set[Subscription] = set()
        self._published: OrderedDict[UUID, int] = OrderedDict()
        self.counts = PushCounts()

    def add(self, subscription: Subscription) -> None:
        """Begin to offer events to a connection."""
        self._subscriptions.add(subscription)

    def remove(self, subscription: Subscription) -> None:
        """Stop it."""
        self._subscriptions.discard(subscription)

    def areas(self) -> list[Position]:
        """Where the connected vehicles are, and where they are moving to."""
        return [area for subscription in self._subscriptions for area in subscription.areas()]

    def resynchronise(self) -> None:
        """Send everybody all that is around them: events were missed."""
        for subscription in self._subscriptions:
            subscription.resynchronise()

    def publish(self, event: ObstacleEvent) -> None:
        """Offer an event to every connection, once; never waits."""
        if event.revision <= self._published.get(event.obstacle_id, 0):
            return
        self._published[event.obstacle_id] = event.revision
        self._published.move_to_end(event.obstacle_id)
        if len(self._published) > _REMEMBERED:
            self._published.popitem(last=False)
        self.counts.published[event.removed_reason or "changed"] += 1
        for subscription in self._subscriptions:
            subscription.offer(event)


class Subscription:
    """One connection: `move` and `offer` are called from outside, `run` sends."""

    def __init__(self, near: Near, send: Send) -> None:
        self._near, self._send = near, send
        self._wake = asyncio.Event()
        self._wanted: Position | None = None
        self._area: Position | None = None
        self._needs_snapshot = True
        self._known: dict[UUID, ObstacleFeature] = {}
        self._queue: dict[UUID, ObstacleEvent] = {}

    def move(self, position: Position) -> None:
        """The vehicle's latest position; one that has not been acknowledged yet is overtaken."""
        self._wanted = position
        self._wake.set()

    def offer(self, event: ObstacleEvent) -> None:
        """Queue an event that concerns the area, or the one being moved to; latest revision wins."""
        if not self._concerns(event):
            return
        queued = self._queue.get(event.obstacle_id)
        if queued is None or event.revision > queued.revision:
            self._queue[event.obstacle_id] = event
        if len(self._queue) > _QUEUE_LIMIT:
            self._queue.clear()
            self._needs_snapshot = True
        self._wake.set()

    def areas(self) -> list[Position]:
        """The area, and the one being moved to, if that is another."""
        if self._wanted is self._area:
            return [] if self._area is None else [self._area]
        return [area for area in (self._area, self._wanted) if area is not None]

    def resynchronise(self) -> None:
        """Send everything in the area."""
        self._needs_snapshot = True
        self._wake.set()

    async def run(self) -> None:
        """Send until cancelled."""
        while True:
            await self._wake.wait()
            self._wake.clear()
            await self._moved()
            await self._synchronised()
            while self._queue and not self._needs_snapshot:
                await self._sent(self._queue.pop(next(iter(self._queue))))

    async def _moved(self) -> None:
        """Move the area to the wanted position: what came and left first, then the acknowledgement."""
        if self._area is None or self._needs_snapshot or self._wanted is None or self._wanted is self._area:
            return
        wanted = self._wanted
        kept = {
            feature.id: feature
            for feature in await self._near(wanted.position, LEAVING_RATIO * wanted.radius_m)
            if feature.id in self._known or is_within(feature.position, wanted.position, wanted.radius_m)
        }
        left = [identifier for identifier in self._known if identifier not in kept]
        came = [feature for identifier, feature in kept.items() if identifier not in self._known]
        self._area, self._known = wanted, {i: self._known.get(i, kept[i]) for i in kept}
        for identifier in left:
            await self._send(Left(position_seq=wanted.position_seq, obstacle_id=identifier))
        for feature in came:
            await self._send(Appeared(position_seq=wanted.position_seq, obstacle=feature))
        await self._send(Moved(position_seq=wanted.position_seq))

    async def _synchronised(self) -> None:
        """Send everything in the area when it is new, or events were dropped."""
        if self._wanted is None or not self._needs_snapshot:
            return
        self._needs_snapshot, self._area = False, self._wanted
        found = await self._near(self._area.position, self._area.radius_m)
        self._known = {feature.id: feature for feature in found}
        await self._send(Snapshot(position_seq=self._area.position_seq, obstacles=found))

    async def _sent(self, event: ObstacleEvent) -> None:
        message = self._message(event)
        if message is not None:
            await self._send(message)

    def _message(self, event: ObstacleEvent) -> ServerMessage | None:
        """What an event means in this area; None when it is outside, or already known at its revision."""
        assert self._area is not None  # noqa: S101  # events are sent after the first snapshot only
        seq, known = self._area.position_seq, self._known.get(event.obstacle_id)
        if known is not None and known.properties.revision >= event.revision:
            return None
        if event.removed_reason is not None:
            return self._removal(event, seq) if self._known.pop(event.obstacle_id, None) else None
        radius_m = self._area.radius_m * (LEAVING_RATIO if known else 1.0)
        if not is_within(event.position, self._area.position, radius_m):
            left = self._known.pop(event.obstacle_id, None)
            return Left(position_seq=seq, obstacle_id=event.obstacle_id) if left else None
        self._known[event.obstacle_id] = event.feature
        kind = Updated if known else Appeared
        return kind(position_seq=seq, obstacle=event.feature)

    def _removal(self, event: ObstacleEvent, seq: int) -> Removed:
        assert event.removed_reason is not None  # noqa: S101  # the caller has just asked
        return Removed(
            position_seq=seq,
            obstacle_id=event.obstacle_id,
            revision=event.revision,
            reason=event.removed_reason,
            merged_into=event.merged_into,
        )

    def _concerns(self, event: ObstacleEvent) -> bool:
        if event.obstacle_id in self._known:
            return True
        return any(is_within(event.position, area.position, area.radius_m) for area in self.areas())
