"""CARLA's numbers for what a surface is, in semantic pictures and semantic sweeps."""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from simulator.scene.scenery import Surface


class SemanticTag(IntEnum):
    """CARLA 0.9.16, `carla.CityObjectLabel` (those that our streets hold)."""

    NONE = 0
    ROADS = 1
    SIDEWALKS = 2
    BUILDINGS = 3
    WALLS = 4
    FENCES = 5
    POLES = 6
    TRAFFIC_LIGHT = 7
    TRAFFIC_SIGNS = 8
    VEGETATION = 9
    TERRAIN = 10
    SKY = 11
    PEDESTRIANS = 12
    CAR = 14
    STATIC = 20
    DYNAMIC = 21
    OTHER = 22
    WATER = 23
    ROAD_LINES = 24
    GROUND = 25


TAG_OF_SURFACE = {
    Surface.NOTHING: SemanticTag.SKY,
    Surface.ROAD: SemanticTag.ROADS,
    # CARLA's towns model the kerb as part of the pavement.
    Surface.KERB: SemanticTag.SIDEWALKS,
    Surface.PAVEMENT: SemanticTag.SIDEWALKS,
    Surface.GROUND: SemanticTag.TERRAIN,
    Surface.WALL: SemanticTag.WALLS,
    Surface.BUILDING: SemanticTag.BUILDINGS,
    Surface.ROOF: SemanticTag.BUILDINGS,
    Surface.CAR: SemanticTag.CAR,
    Surface.WHEEL: SemanticTag.CAR,
    Surface.TREE: SemanticTag.VEGETATION,
    Surface.TRUNK: SemanticTag.VEGETATION,
    Surface.POLE: SemanticTag.POLES,
    # "Elements whose position is susceptible to change over time", such as bins and bags.
    Surface.DEBRIS: SemanticTag.DYNAMIC,
    Surface.HILL: SemanticTag.TERRAIN,
    Surface.PEDESTRIAN: SemanticTag.PEDESTRIANS,
    Surface.WATER: SemanticTag.WATER,
    Surface.MANHOLE: SemanticTag.ROADS,
    Surface.ROAD_MARK: SemanticTag.ROAD_LINES,
}

OBSTACLE_OBJECTS_FROM = 1_000_000
"""In semantic sweeps an obstacle's object index is its number plus this; below it are the numbers of moving things."""


TAGS_FROM = 128
"""A surface value from here on is CARLA's tag plus this: what a CARLA server says, which has more tags than we."""


def semantic_tags(surface: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """CARLA's tag of each `Surface` value; `ValueError` for a number that is none."""
    values = np.unique(surface)
    table = np.zeros(256, dtype=np.uint8)
    table[values] = [TAG_OF_SURFACE[Surface(v)] if v < TAGS_FROM else v - TAGS_FROM for v in values.tolist()]
    return table[surface]


def object_indices(obstacle_id: NDArray[np.int32], mover_id: NDArray[np.int32]) -> NDArray[np.uint32]:
    """CARLA's `ObjIdx` of each point: the moving thing's number, else the obstacle's from a million on, else 0."""
    obstacle = np.where(obstacle_id > 0, obstacle_id + OBSTACLE_OBJECTS_FROM, 0)
    return np.where(mover_id > 0, mover_id, obstacle).astype(np.uint32)
