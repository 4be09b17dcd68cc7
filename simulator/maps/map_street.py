"""A drivable world from an OpenDRIVE map: routes through its lanes, the roads in sight of them, what lies on them."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from contract.geometry import LatLon
from simulator.maps.map_roads import opened_where_they_meet, roads_of
from simulator.maps.map_routes import Lanes
from simulator.maps.opendrive import LaneKey, OpenDriveMap, OpenDriveRoad, read_opendrive
from simulator.maps.opendrive_xml import OpenDriveError
from simulator.streets.course import (
    BEHIND_M,
    MOST_EAGER,
    SPEED_LIMIT_MPS,
    Course,
    Stretch,
    driving_time_s,
    last_start_m,
)
from simulator.streets.placing import apart, placed_obstacle, random_features, random_obstacle, random_parked_cars
from simulator.streets.road import Road
from simulator.streets.street import DRAWN_BEYOND_M, GeoReference, PlacedObstacle, Roadside, Roughness, Street
from simulator.streets.trajectory import Path
from simulator.streets.world_plan import WorldPlan

FloatArray = NDArray[np.float64]

MOST_STARTS = 300
"""Places from which a route is looked for; a city has thousands, and any of the first will do there."""

CROSSING_STEP_M, CROSSING_M = 2.0, 5.0
"""A way that comes back this near to itself crosses itself; opposite lanes of one street count too."""

OTHER_ROUTES = 12
"""Ways of other traffic: two or three at each crossing of a drive of 20 s."""

OWN_LANE_SHARE = 0.8
"""Of the obstacles lie in the egos' lane, the others where traffic comes from elsewhere."""


@dataclass(frozen=True, slots=True)
class MapFile:
    """An OpenDRIVE file as part of a plan, its content by its SHA-256; `origin` as for `read_opendrive`."""

    path: FilePath
    sha256: str
    origin: LatLon | None = None

    @classmethod
    def at(cls, path: FilePath, origin: LatLon | None = None) -> MapFile:
        """The file as it is now. `OpenDriveError` if it cannot be read."""
        return cls(path, _sha256(path), origin)

    def read(self) -> OpenDriveMap:
        """Its roads and lanes. `OpenDriveError` says what is wrong with the file, also if it has been changed."""
        if _sha256(self.path) != self.sha256:
            raise OpenDriveError(f"{self.path}: was changed while it was used; start again")
        return read_opendrive(self.path, self.origin)

    @property
    def named(self) -> dict[str, object]:
        """What a recording says of its map."""
        origin = self.origin.model_dump() if self.origin is not None else None
        return {"file": self.path.name, "sha256": self.sha256, "origin": origin}


@dataclass(frozen=True, slots=True)
class Convoy:
    """What is to be driven: `egos` over `behind_m` from the first to the last, who record for `seconds`.

    They record at different times, so that all together drive for `duration_s`.
    """

    egos: int
    behind_m: float
    seconds: float
    duration_s: float


def map_course(opendrive: OpenDriveMap, seed: int, plan: WorldPlan, convoy: Convoy) -> Course:
    """The part of a map around a route that is long enough for a convoy; the same arguments give the same course.

    `OpenDriveError` if there is no such route, with the time that the longest one takes.
    """
    rng = np.random.default_rng([seed, 31])
    lanes = Lanes(opendrive.roads)
    own = _own_route(rng, lanes, convoy)
    way = lanes.path(own)
    seen = _in_sight(opendrive.roads, way)
    paths = [way, *_other_paths(rng, Lanes(seen), own, convoy)]
    roads, driven = _roads(seen, own)
    stretches = tuple(Stretch(road, road.line.start_m, road.line.end_m) for road in roads[:driven])
    styles = list(Roadside)
    left, right = (styles[index] for index in rng.integers(len(styles), size=2))
    place = opendrive.place
    street = Street(
        seed,
        obstacles=_obstacles(rng, plan, paths, lanes.least_width(own), seed),
        roads=tuple(roads),
        roadsides=(left, right),
        roughness=plan.roughness or (Roughness.A, Roughness.B, Roughness.C)[rng.choice(3, p=(0.45, 0.35, 0.20))],
        yaw_rad=place.yaw_rad,
        origin_enu_m=(0.0, 0.0, 0.0),
        georeference=GeoReference(place.position, place.altitude_m),
    )
    features = random_features(rng, plan, stretches, street.obstacles)
    street = replace(street, features=features, parked_cars=random_parked_cars(rng, stretches))
    return Course(street, tuple(paths), 0.0, stretches)


def _own_route(rng: np.random.Generator, lanes: Lanes, convoy: Convoy) -> list[LaneKey]:
    start_m = BEHIND_M + convoy.behind_m
    wanted_m = start_m + SPEED_LIMIT_MPS * MOST_EAGER * convoy.duration_s + BEHIND_M
    starts = lanes.starts
    longest_s, longest_m, crossing = 0.0, 0.0, False
    for index in rng.permutation(len(starts))[:MOST_STARTS]:
        route = lanes.route(rng, starts[index], wanted_m)
        path = lanes.path(route)
        if last_start_m(path, convoy.duration_s) >= start_m:
            if convoy.egos == 1 or not crosses_itself(path):
                return route
            crossing = True
        longest_s = max(longest_s, driving_time_s(path, start_m))
        longest_m = max(longest_m, path.line.length_m)
    if crossing:
        raise OpenDriveError(
            f"every route through the map that lasts {convoy.seconds:g} s crosses itself, where vehicles that follow "
            "each other may meet; use --egos 1 or fewer --seconds"
        )
    raise OpenDriveError(_too_short(convoy, longest_m, longest_s))


def crosses_itself(path: Path) -> bool:
    """Whether a path comes back to where it has been."""
    s = np.arange(path.line.start_m, path.line.end_m, CROSSING_STEP_M)
    points = path.line.at(s).position_m[:, :2]
    near = cKDTree(points).query_pairs(CROSSING_M, output_type="ndarray")
    return bool((np.abs(near[:, 0] - near[:, 1]) * CROSSING_STEP_M > 4 * CROSSING_M).any())


def _too_short(convoy: Convoy, longest_m: float, longest_s: float) -> str:
    if not longest_m:
        return "the map has no lane of type driving that is wide enough for a car"
    # A tenth of a second less, for the steps in which the times are added up.
    fits_s = math.floor(10 * (longest_s - (convoy.duration_s - convoy.seconds)) - 1) / 10
    advice = f"use --seconds {fits_s:g} or less" if fits_s >= 0.1 else "use fewer --egos or a larger map"
    return (
        f"the longest route through the map is {longest_m:.0f} m: too short for {convoy.egos} vehicles and "
        f"{convoy.seconds:g} s; {advice}"
    )


def _other_paths(rng: np.random.Generator, lanes: Lanes, own: Sequence[LaneKey], convoy: Convoy) -> list[Path]:
    """Ways of other traffic that begin in lanes which no way before led through."""
    wanted_m = SPEED_LIMIT_MPS * MOST_EAGER * convoy.duration_s + DRAWN_BEYOND_M
    taken, starts = set(own), lanes.starts
    # First what lies along the way of the egos: the other lanes of its roads.
    beside = {key.road_id for key in own}
    order = sorted(rng.permutation(len(starts)).tolist(), key=lambda index: starts[index].road_id not in beside)
    paths: list[Path] = []
    for index in order:
        if len(paths) == OTHER_ROUTES:
            break
        if starts[index] not in taken:
            route = lanes.route(rng, starts[index], wanted_m, taken)
            taken.update(route)
            paths.append(lanes.path(route))
    return paths


def _in_sight(roads: Sequence[OpenDriveRoad], path: Path) -> list[OpenDriveRoad]:
    """The roads that come near a path."""
    way = cKDTree(path.line.at(np.arange(path.line.start_m, path.line.end_m, 5.0)).position_m[:, :2])
    return [
        road
        for road in roads
        if any(float(np.min(way.query(lane.centre_m[:, :2])[0])) < DRAWN_BEYOND_M for lane in road.lanes)
    ]


def _roads(seen: Sequence[OpenDriveRoad], own: Sequence[LaneKey]) -> tuple[list[Road], int]:
    """The roads to be drawn, those that the egos' route leads along first, and how many these are."""
    order = {key.road_id: place for place, key in reversed(list(enumerate(own)))}
    driven = [road for road in seen if road.road_id in order and road.junction_id == -1]
    along = [one for road in sorted(driven, key=lambda road: order[road.road_id]) for one in roads_of(road)]
    beside = [one for road in seen if all(road is not other for other in driven) for one in roads_of(road)]
    return opened_where_they_meet([*along, *beside]), len(along)


def _obstacles(
    rng: np.random.Generator, plan: WorldPlan, paths: Sequence[Path], lane_width_m: float, seed: int
) -> tuple[PlacedObstacle, ...]:
    """Along the egos' way, and some in other lanes in sight of it."""
    placed: list[PlacedObstacle] = []
    own = paths[0].line
    spacing = 100.0 / plan.obstacles_per_100m if plan.obstacles_per_100m else math.inf
    s = 2 * BEHIND_M + float(rng.uniform(0.3, 1.0)) * spacing
    while s < own.end_m - BEHIND_M:
        number = len(placed) + 1
        what = random_obstacle(rng, plan, lane_width_m, seed * 1_000 + number)
        line, at = own, s
        if rng.random() >= OWN_LANE_SHARE and len(paths) > 1:
            line = paths[int(rng.integers(1, len(paths)))].line
            at = float(rng.uniform(line.start_m, line.end_m))
        obstacle = placed_obstacle(rng, number, what, line, (at, 0.0), lane_width_m)
        if apart(obstacle, placed):
            placed.append(obstacle)
        s += spacing * float(rng.uniform(0.6, 1.4))
    return tuple(placed)


def _sha256(path: FilePath) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise OpenDriveError(f"{path}: cannot be read: {error.strerror}") from error
