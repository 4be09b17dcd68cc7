"""What stands upright and slender beside the lane, as bollards do where a road has no kerb: nobody is told of it."""

from __future__ import annotations

import math

from detector.types import ObstacleKind

POST_BESIDE_M = 1.75
"""Half a lane of 3.5 m: what stands farther beside the car's course is not in the way of whoever follows it."""

POST_HEIGHT_M, POST_SLENDERNESS = 0.4, 1.5
"""Bollards and marker posts are half a metre to a metre high and 0.1 to 0.3 m thick; what falls off a lorry lies."""


def is_post(kind: ObstacleKind, beside_m: float, length_m: float, width_m: float, relief_m: float) -> bool:
    """Whether an obstacle of that size, so far beside the car's course, is a post: nobody is told of it."""
    return beside_m >= POST_BESIDE_M and is_slender(kind, length_m, width_m, relief_m)


def is_slender(kind: ObstacleKind, length_m: float, width_m: float, relief_m: float) -> bool:
    """Whether an obstacle of that size is upright and slender, as a post is."""
    return kind is ObstacleKind.DEBRIS and relief_m >= max(
        POST_HEIGHT_M, POST_SLENDERNESS * math.sqrt(length_m * width_m)
    )
