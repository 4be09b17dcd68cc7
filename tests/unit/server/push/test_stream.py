"""Fan-out: latest wins, a slow vehicle is resynchronised, and delays nobody."""

from __future__ import annotations

import asyncio

from contract.events import Appeared, Position, Removed, ServerMessage, Snapshot, Updated
from contract.geometry import LatLon
from contract.obstacle import ObstacleFeature
from server.geometry.geodesy import distance_m
from server.life.obstacle import Obstacle
from server.life.policy import COOPERATION
from server.push.stream import Hub, Subscription
from server.storage.features import ObstacleEvent, event_of, feature_of, feature_text
from tests.unit.server.making import NOON, PATRAS, Road, detection

HERE = Position(position_seq=1, position=PATRAS, radius_m=200)


def changed_to(obstacle: Obstacle) -> ObstacleEvent:
    return event_of(obstacle, feature_text(obstacle, COOPERATION.life))


class Place:
    """Obstacles as a database would answer, and a vehicle that reads when it is let."""

    def __init__(self) -> None:
        self.obstacles: dict[object, Obstacle] = {}
        self.heard: list[ServerMessage] = []
        self.reads = asyncio.Event()
        self.reads.set()

    async def near(self, centre: LatLon, radius_m: float) -> tuple[ObstacleFeature, ...]:
        features = [feature_of(obstacle, COOPERATION.life) for obstacle in self.obstacles.values()]
        return tuple(feature for feature in features if distance_m(feature.position, centre) <= radius_m)

    async def send(self, message: ServerMessage) -> None:
        await self.reads.wait()
        self.heard.append(message)

    def changed(self, obstacle: Obstacle) -> ObstacleEvent:
        self.obstacles[obstacle.id] = obstacle
        return changed_to(obstacle)


def holes(count: int) -> list[Obstacle]:
    road = Road()
    for row in range(0, count, 10):
        road.sees("ego1", NOON, *(detection(4.0 * (n - 5), 0.4 * row - 50, 500, 400) for n in range(10)), pose_sd_m=0.1)
    return list(road.obstacles.values())[:count]


async def settled() -> None:
    for _ in range(50):
        await asyncio.sleep(0)


async def test_only_the_latest_revision_of_each_obstacle_waits() -> None:
    place, (hole,) = Place(), holes(1)
    subscription = Subscription(place.near, place.send)
    running = asyncio.create_task(subscription.run())
    subscription.move(HERE)
    await settled()
    place.reads.clear()
    subscription.offer(place.changed(hole))
    await settled()
    for revision in range(2, 50):
        subscription.offer(place.changed(hole._replace(revision=revision)))
    place.reads.set()
    await settled()
    running.cancel()
    assert [type(message) for message in place.heard] == [Snapshot, Appeared, Updated]
    assert isinstance(place.heard[-1], Updated)
    assert place.heard[-1].obstacle.properties.revision == 49


async def test_an_older_revision_is_not_sent_after_a_newer_one() -> None:
    place, (hole,) = Place(), holes(1)
    subscription = Subscription(place.near, place.send)
    running = asyncio.create_task(subscription.run())
    place.changed(hole._replace(revision=5))
    subscription.move(HERE)
    await settled()
    subscription.offer(changed_to(hole._replace(revision=4)))
    await settled()
    running.cancel()
    assert [type(message) for message in place.heard] == [Snapshot]


async def test_a_slow_vehicle_is_resynchronised_and_delays_nobody() -> None:
    hub, slow, quick, many = Hub(), Place(), Place(), holes(300)
    quick.obstacles = slow.obstacles
    subscriptions = [Subscription(place.near, place.send) for place in (slow, quick)]
    running = [asyncio.create_task(subscription.run()) for subscription in subscriptions]
    for subscription in subscriptions:
        hub.add(subscription)
        subscription.move(HERE)
    await settled()
    slow.reads.clear()
    for hole in many:
        hub.publish(slow.changed(hole))
        await asyncio.sleep(0)
    await settled()
    assert sum(isinstance(message, Appeared) for message in quick.heard) == 300
    slow.reads.set()
    await settled()
    for task in running:
        task.cancel()
    snapshots = [message for message in slow.heard if isinstance(message, Snapshot)]
    assert len(snapshots) == 2
    assert len(snapshots[-1].obstacles) == 300


async def test_a_removal_is_told_to_those_who_knew_the_obstacle_only() -> None:
    place, stranger, (hole,) = Place(), Place(), holes(1)
    place.changed(hole)
    subscriptions = [Subscription(each.near, each.send) for each in (place, stranger)]
    running = [asyncio.create_task(subscription.run()) for subscription in subscriptions]
    for subscription in subscriptions:
        subscription.move(HERE)
    await settled()
    gone = hole._replace(revision=2, removed_at=NOON, removed_reason="absent")
    for subscription in subscriptions:
        subscription.offer(changed_to(gone))
    await settled()
    for task in running:
        task.cancel()
    assert [type(message) for message in place.heard] == [Snapshot, Removed]
    assert [type(message) for message in stranger.heard] == [Snapshot]
