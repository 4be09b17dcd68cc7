"""Confidence fades while nobody sees the obstacle. Pure."""

from __future__ import annotations

import math
from datetime import datetime, timedelta

from contract.geometry import Kind
from server.life.obstacle import Obstacle
from server.life.policy import Life

# Moments end with the year 1, and nothing that is stored expired a thousand years ago.
_LONGEST_S = timedelta(days=365_250).total_seconds()


def expires_at(obstacle: Obstacle, life: Life) -> datetime:
    """When decay brings the confidence below what is worth a warning."""
    half_lives = max(0.0, math.log2(max(obstacle.confidence, life.expired_confidence) / life.expired_confidence))
    return obstacle.as_of + timedelta(seconds=half_lives * life.half_life_s[obstacle.kind])


def lasts_s(confidence: float, kind: Kind, life: Life) -> float:
    """How long before `expires_at` decay passes a confidence above 0: as many half-lives for all of a kind."""
    return max(-_LONGEST_S, math.log2(confidence / life.expired_confidence) * life.half_life_s[kind])
