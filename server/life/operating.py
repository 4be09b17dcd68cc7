"""What an operator's action makes of an obstacle. Pure: the obstacle, the action and the time in, the new value out."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime
from typing import Literal

from contract.history import Confirm, Dismiss, Inspect, OperatorAction, Repaired, Standing
from contract.observation import Descriptor, State
from contract.obstacle import InspectionState
from server.errors import ObstacleRemovedError
from server.life.decay import expires_at
from server.life.obstacle import Obstacle, Shape
from server.life.policy import Life

ERASED = Descriptor(name="erased", version=1, values={})
"""Stands for a descriptor that was deleted for privacy."""

OperatorDeed = OperatorAction | Literal["delete"]
Deed = OperatorDeed | Literal["expire"]
"""`expire` is the server's own."""


def decide(obstacle: Obstacle, deed: OperatorDeed, now: datetime) -> Obstacle:
    """The obstacle after the action; the very same value when the action changes nothing.

    Raises `ObstacleRemovedError` when a removed obstacle is to be confirmed.
    """
    after = _after(obstacle, deed, now)
    return obstacle if after == obstacle else after._replace(revision=obstacle.revision + 1)


def expired(obstacle: Obstacle, now: datetime, life: Life) -> Obstacle:
    """The obstacle removed when its confidence has decayed below what is worth a warning; else the very same value."""
    if not obstacle.is_live or (moment := expires_at(obstacle, life)) > now:
        return obstacle
    return obstacle._replace(
        state=State.REMOVED,
        removed_at=moment,
        removed_reason="expired",
        revision=obstacle.revision + 1,
    )


def erased(shape: Shape) -> Shape:
    """A shape without what was measured point by point."""
    return replace(shape, points_cm=(), descriptor=ERASED)


def standing(obstacle: Obstacle) -> Standing:
    """What the audit log says of an obstacle before and after."""
    return Standing(state=obstacle.state, inspection_state=obstacle.inspection_state, revision=obstacle.revision)


def _after(obstacle: Obstacle, deed: OperatorDeed, now: datetime) -> Obstacle:
    match deed:
        case Confirm():
            return _confirmed(obstacle)
        case Dismiss():
            return _removed(obstacle, now)._replace(inspection_state=InspectionState.NOT_AN_ISSUE)
        case Repaired():
            return _removed(obstacle, now)._replace(inspection_state=InspectionState.REPAIRED)
        case Inspect(inspection_state=inspection_state):
            return obstacle._replace(inspection_state=inspection_state)
        case "delete":
            return _removed(obstacle, now)._replace(shape=erased(obstacle.shape))


def _confirmed(obstacle: Obstacle) -> Obstacle:
    if not obstacle.is_live:
        raise ObstacleRemovedError("the obstacle was removed and does not come back; a new sighting makes a new one")
    seen = obstacle.inspection_state is InspectionState.OPEN
    return obstacle._replace(
        state=State.CONFIRMED,
        inspection_state=InspectionState.INSPECTED if seen else obstacle.inspection_state,
    )


def _removed(obstacle: Obstacle, now: datetime) -> Obstacle:
    if not obstacle.is_live:
        return obstacle
    return obstacle._replace(state=State.REMOVED, removed_at=now, removed_reason="operator")
