"""Nearby queries as files for wrk: circles about stored obstacles, asked again and again, or each once."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.server_data import DEGREE_M, RADIUS_M, FloatArray
from benchmarks.server_load import Load
from contract.geometry import LatLon
from server.geometry.quadkey import cell_of, tile_of_cell

KEY = "an-operator-key-of-the-benchmark-only"
_NEAR_DEG = 2e-4

PathOf = Callable[[float, float, float], str]
"""A request's path, from latitude and longitude in degrees and a radius in metres."""


def circle_path(latitude_deg: float, longitude_deg: float, radius_m: float) -> str:
    """The query of a vehicle."""
    return f"/v1/obstacles?lat={latitude_deg:.7f}&lon={longitude_deg:.7f}&radius_m={radius_m:.0f}"


def filtered_path(latitude_deg: float, longitude_deg: float, radius_m: float) -> str:
    """The same with a filter that every obstacle passes."""
    return f"{circle_path(latitude_deg, longitude_deg, radius_m)}&kind=pothole,bump"


def box_about(latitude_deg: float, longitude_deg: float, radius_m: float) -> tuple[float, float, float, float]:
    """West, south, east and north, in degrees, of the box with the circle's area: it holds as much on average."""
    half_m = radius_m * math.sqrt(math.pi) / 2
    north_deg = half_m / DEGREE_M
    east_deg = north_deg / math.cos(math.radians(latitude_deg))
    return longitude_deg - east_deg, latitude_deg - north_deg, longitude_deg + east_deg, latitude_deg + north_deg


def box_text(latitude_deg: float, longitude_deg: float, radius_m: float) -> str:
    """The box as the parameter `bbox`."""
    return ",".join(f"{edge:.7f}" for edge in box_about(latitude_deg, longitude_deg, radius_m))


def box_path(latitude_deg: float, longitude_deg: float, radius_m: float) -> str:
    """The query of a map."""
    return f"/v1/obstacles?bbox={box_text(latitude_deg, longitude_deg, radius_m)}"


def near_obstacles(places_deg: FloatArray, number: int, seed: int) -> FloatArray:
    """Places (number, 2) some metres from random obstacles."""
    rng = np.random.default_rng(seed)
    return places_deg[rng.integers(len(places_deg), size=number)] + rng.normal(0.0, _NEAR_DEG, (number, 2))


def one_in_each_tile(places_deg: FloatArray) -> FloatArray:
    """A place (tiles, 2) in every tile that holds an obstacle."""
    tiles: dict[int, tuple[float, float]] = {}
    for latitude_deg, longitude_deg in places_deg.tolist():
        place = LatLon(latitude_deg=latitude_deg, longitude_deg=longitude_deg)
        tiles.setdefault(tile_of_cell(cell_of(place)), (latitude_deg, longitude_deg))
    return np.array(list(tiles.values()))


def write_queries(path: Path, places_deg: FloatArray, path_of: PathOf = circle_path) -> Load:
    """Queries about places, one in each line."""
    lines = (
        f"{path_of(latitude_deg, longitude_deg, RADIUS_M)}\n" for latitude_deg, longitude_deg in places_deg.tolist()
    )
    path.write_text("".join(lines), encoding="ascii")
    return Load(path, key=KEY)
