"""Does the descriptor know an obstacle again? Distances between passes of the same and of other obstacles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from contract.geometry import Box, Kind
from contract.observation import Descriptor
from detector.types import DetectedObstacle
from evaluation.passes_sizes import Measured
from server.life.matching import shape_distance

Described = tuple[Descriptor, Box]


def descriptor_figures(rows: Sequence[Measured]) -> dict[str, float]:
    """Shares in per cent of pairs of passes of one obstacle that are closer than the second pass's neighbour is.

    `neighbour`: the nearest obstacle of its sign along the street; `any`: whichever obstacle of its sign on the street
    is the most alike. Streets have several holes of one size, so that only their forms differ.
    """
    found = [row for row in rows if row.measured is not None]
    described = [_described(row.measured) for row in found if row.measured is not None]
    closer: dict[str, list[bool]] = {"neighbour": [], "any": []}
    for i, row in enumerate(found):
        others = [
            (abs(_along(other) - _along(row)), shape_distance(*described[i], *described[j]))
            for j, other in enumerate(found)
            if other.street == row.street
            and other.obstacle_id != row.obstacle_id
            and _negative(other) == _negative(row)
        ]
        if not others:
            continue
        nearest_m = min(apart for apart, _ in others)
        neighbour = min(distance for apart, distance in others if apart == nearest_m)
        alike = min(distance for _, distance in others)
        for j, other in enumerate(found):
            if other.place == row.place and j != i:
                distance = shape_distance(*described[i], *described[j])
                closer["neighbour"].append(distance < neighbour)
                closer["any"].append(distance < alike)
    figures = {name: 100 * float(np.mean(values)) for name, values in closer.items() if values}
    return {"pairs": len(closer["any"]), **figures}


def _described(obstacle: DetectedObstacle) -> Described:
    descriptor = obstacle.descriptor
    box = Box(
        length_mm=round(obstacle.length_m * 1000),
        width_mm=round(obstacle.width_m * 1000),
        yaw_rad=obstacle.yaw_rad,
        relief_mm=round(obstacle.relief_m * 1000),
    )
    return Descriptor(name=descriptor.name, version=descriptor.version, values=descriptor.values), box


def _along(row: Measured) -> float:
    """Obstacles are numbered along their street."""
    return float(row.obstacle_id)


def _negative(row: Measured) -> bool:
    return row.size not in (Kind.BUMP.value, Kind.DEBRIS.value)
