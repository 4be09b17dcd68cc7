"""Kerbs, pavements, verges and walls: profiles drawn along both edges of a road, with gaps where roads join it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from simulator.mesh import Mesh, grid, joined
from simulator.scene.scenery import Part, Surface
from simulator.scene.terrain import mouth_stations
from simulator.streets.road import OVERLAP_M, Road

FloatArray = NDArray[np.float64]

KERB_WIDTH_M = 0.15
VERGE_WIDTH_M = 1.7
SKIRT_M = 0.6
"""How far borders reach down, below the lowest ground beside them."""

WALL_SETBACK_M, WALL_THICKNESS_M, WALL_HEIGHT_M, COPING_M = 2.0, 0.25, 1.5, 0.04
STATION_M = 2.0
"""An arc of 50 m radius and its chords over 2 m differ by a centimetre."""


def borders(road: Road) -> list[Part]:
    """Kerb, pavement and verge of the sides that have a pavement, a plain verge on the others."""
    section = road.section
    top, back = section.kerb_height_m, section.pavement_width_m
    kerb = [(0.0, -0.3), (0.0, top - 0.015), (0.015, top), (KERB_WIDTH_M, top)]
    verge = [(back, top + 0.03), (back + VERGE_WIDTH_M, top + 0.05), (back + VERGE_WIDTH_M, -SKIRT_M)]
    plain = [(0.0, -0.01), (VERGE_WIDTH_M, -0.06), (VERGE_WIDTH_M, -SKIRT_M)]
    paved = tuple(side for side in (1, -1) if road.has_kerb(side))
    return [
        *_drawn(Surface.KERB, road, paved, kerb),
        *_drawn(Surface.PAVEMENT, road, paved, [(KERB_WIDTH_M, top), (back, top + 0.03)]),
        *_drawn(Surface.GROUND, road, paved, verge),
        *_drawn(Surface.GROUND, road, tuple(side for side in (1, -1) if side not in paved), plain),
    ]


def wall(road: Road, side: int, start_m: float, end_m: float) -> list[Part]:
    """A wall with a coping at the back of the pavement of one side, between two distances."""
    front, back, top = WALL_SETBACK_M, WALL_SETBACK_M + WALL_THICKNESS_M, WALL_HEIGHT_M
    profile = [(front, -SKIRT_M), (front, top), (front - COPING_M, top), (front - COPING_M, top + 0.07)]
    profile += [(back + COPING_M, top + 0.07), (back, -SKIRT_M)]
    # Half a metre more than the verge stays open, for pavements that turn into the joining road.
    pieces = [piece for piece in stretches(road, side, 0.5 + WALL_SETBACK_M, start_m, end_m) if np.ptp(piece) > 1]
    return [Part(Surface.WALL, joined([_strip(road, side, piece, profile) for piece in pieces]))] if pieces else []


def stretches(road: Road, side: int, margin_m: float, start_m: float, end_m: float) -> list[FloatArray]:
    """Stations along one side between two distances, in pieces that leave its openings free by a margin."""
    return [_stations(road, start, end) for start, end in road.closed(side, margin_m, start_m, end_m)]


def _stations(road: Road, start_m: float, end_m: float) -> FloatArray:
    stations = np.linspace(start_m, end_m, max(2, round((end_m - start_m) / STATION_M) + 1))
    if road.joins is None:
        return stations
    mouth = mouth_stations(road)
    return np.unique(np.concatenate([stations, mouth[(mouth > start_m) & (mouth < end_m)]]))


def _drawn(surface: Surface, road: Road, sides: Sequence[int], profile: list[tuple[float, float]]) -> list[Part]:
    first = road.line.start_m + (OVERLAP_M if road.joins is not None else 0.0)
    strips = [
        _strip(road, side, stations, profile)
        for side in sides
        for stations in stretches(road, side, 0.0, first, road.line.end_m)
    ]
    return [Part(surface, joined(strips))] if strips else []


def _strip(road: Road, side: int, stations_m: FloatArray, profile: list[tuple[float, float]]) -> Mesh:
    """A profile of (outward from the edge, above the edge) drawn along one side of a road."""
    outward, up = (np.array(values) for values in zip(*profile, strict=True))
    edge = side * road.half_width(stations_m)
    s = np.repeat(stations_m, len(profile))
    t = (edge[:, None] + side * outward).ravel()
    plan = road.line.plan(s, t)
    rise = np.tile(up, len(stations_m))
    z = np.repeat(road.height(stations_m, edge), len(profile)) + rise
    shape = (len(stations_m), len(profile), 3)
    vertices = np.concatenate([plan, z[:, None]], axis=1)
    return grid(vertices.reshape(shape), np.stack([s, t, rise], axis=1).reshape(shape))
