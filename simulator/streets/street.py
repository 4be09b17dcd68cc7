"""A street as a frozen description: where it lies on the earth, its roads, what stands beside them, its obstacles.

Frame `street`: Cartesian, z up; a straight street runs along x with its crown at y = 0, z = 0. Traffic drives on the
right, so that its ego lane is y < 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum, IntEnum

import numpy as np
import pymap3d
from numpy.typing import NDArray

from contract.geometry import Kind, LatLon
from simulator.mesh import pose
from simulator.shapes.debris import Debris, broken_pallet
from simulator.shapes.hump import bump
from simulator.shapes.pothole import pothole
from simulator.shapes.relief import Relief
from simulator.streets.road import Road, straight_road
from simulator.streets.road_features import joint, manhole, patch

FloatArray = NDArray[np.float64]

DRAWN_BEYOND_M = 160.0
"""Roads go on beyond the part that is driven: farther than a LiDAR's 120 m, and lost in the haze."""

LANE_CENTRE_M = -1.75
"""Middle of the right lane of a road 7 m wide."""


@dataclass(frozen=True, slots=True)
class GeoReference:
    """Origin of the `enu` frame on the WGS 84 ellipsoid."""

    position: LatLon
    altitude_m: float

    def enu_from_geodetic(self, position: LatLon, altitude_m: float) -> FloatArray:
        """(3,) east, north, up of a position."""
        here = self.position
        enu = pymap3d.geodetic2enu(
            position.latitude_deg,
            position.longitude_deg,
            altitude_m,
            here.latitude_deg,
            here.longitude_deg,
            self.altitude_m,
        )
        return np.array(enu, dtype=np.float64)

    def geodetic_from_enu(self, enu_m: FloatArray) -> tuple[LatLon, float]:
        """Position and altitude above the ellipsoid of a (3,) east, north, up."""
        here = self.position
        latitude, longitude, altitude = pymap3d.enu2geodetic(
            *enu_m, here.latitude_deg, here.longitude_deg, self.altitude_m
        )
        return LatLon(latitude_deg=float(latitude), longitude_deg=float(longitude)), float(altitude)


@dataclass(frozen=True, slots=True)
class PlacedObstacle:
    """An obstacle in the street, and its truth: `shape` about (x, y), turned by `yaw_rad` from the street's x.

    `obstacle_id` is 1 or more; 0 means "no obstacle" in labels. A filled one is a patch in the asphalt.
    """

    obstacle_id: int
    kind: Kind
    x_m: float
    y_m: float
    yaw_rad: float
    shape: Relief | Debris
    filled: bool = False

    def local(self, x_m: FloatArray, y_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions of the street in the obstacle's own frame."""
        return _local(self, x_m, y_m)

    def covers(self, x_m: FloatArray, y_m: FloatArray) -> NDArray[np.bool_]:
        """Whether positions of the street lie inside the footprint, filled or not."""
        return self.shape.covers(*self.local(x_m, y_m))


@dataclass(frozen=True, slots=True)
class ParkedCar:
    """A car at the roadside, its middle at (x, y); `roll_rad` when two wheels stand on the kerb."""

    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float
    roll_rad: float
    colour: tuple[float, float, float]


class Feature(IntEnum):
    """What a road carries besides damage; a detector must stay silent over all of them."""

    PATCH = 1
    MANHOLE = 2
    JOINT = 3


class Roughness(Enum):
    """Road classes of ISO 8608, table C.1, by the geometric mean of their spectral density Gd(n0), m^3.

    n0 = 0.1 cycles per metre; the density falls as n^-2.
    """

    A = 16e-6
    B = 64e-6
    C = 256e-6


class Roadside(Enum):
    """What stands along one side of the main road."""

    HOUSES = "houses"
    WALL = "wall"
    TREES = "trees"
    MIXED = "mixed"


@dataclass(frozen=True, slots=True)
class PlacedFeature:
    """Something of the road that is no obstacle: `shape` about (x, y), turned by `yaw_rad` from the street's x."""

    kind: Feature
    x_m: float
    y_m: float
    yaw_rad: float
    shape: Relief

    def local(self, x_m: FloatArray, y_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions of the street in the feature's own frame."""
        return _local(self, x_m, y_m)


@dataclass(frozen=True, slots=True, eq=False)
class Street:
    """Roads in one flat frame, what is worn into them, what lies on them, what stands beside them.

    The first road is the main one. `yaw_rad` turns the frame counter-clockwise from east; its origin lies at
    `origin_enu_m`.
    """

    seed: int
    obstacles: tuple[PlacedObstacle, ...] = ()
    parked_cars: tuple[ParkedCar, ...] = ()
    features: tuple[PlacedFeature, ...] = ()
    roads: tuple[Road, ...] = field(default_factory=lambda: (straight_road(320.0, DRAWN_BEYOND_M),))
    roadsides: tuple[Roadside, ...] = (Roadside.HOUSES, Roadside.WALL)
    roughness: Roughness = Roughness.A
    yaw_rad: float = math.radians(35.0)
    origin_enu_m: tuple[float, float, float] = (12.0, -7.5, 0.4)
    georeference: GeoReference = field(
        default=GeoReference(LatLon(latitude_deg=38.2466, longitude_deg=21.7346), altitude_m=60.0)
    )

    @property
    def main(self) -> Road:
        """The road that vehicles drive along."""
        return self.roads[0]

    @property
    def length_m(self) -> float:
        """Of the main road, without what is drawn beyond both ends."""
        return self.main.line.end_m - DRAWN_BEYOND_M

    @property
    def enu_from_street(self) -> FloatArray:
        """(4, 4) rigid transform."""
        return pose(*self.origin_enu_m, yaw_rad=self.yaw_rad)

    def obstacle(self, obstacle_id: int) -> PlacedObstacle:
        """The obstacle of that number; `KeyError` if there is none."""
        return {placed.obstacle_id: placed for placed in self.obstacles}[obstacle_id]

    def sound_height(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        """Height (N,) of the smooth, sound road under positions (N,), of the nearest road off all of them."""
        xy = np.stack([x_m, y_m], axis=1)
        height, nearest = np.zeros(len(xy)), np.full(len(xy), np.inf)
        for road in self.roads:
            s, t = road.line.project(xy)
            edge = road.half_width(s)
            outside = np.maximum(np.abs(t) - edge, 0)
            better = outside < nearest
            if better.any():
                clipped = np.clip(t[better], -edge[better], edge[better])
                height[better], nearest[better] = road.height(s[better], clipped), outside[better]
        return height

    def enu_of(self, obstacle_id: int) -> FloatArray:
        """(3,) east, north, up of the centre of an obstacle at the height of the sound road."""
        placed = self.obstacle(obstacle_id)
        z = float(self.sound_height(np.array([placed.x_m]), np.array([placed.y_m]))[0])
        return np.asarray((self.enu_from_street @ np.array([placed.x_m, placed.y_m, z, 1.0]))[:3])

    def position_of(self, obstacle_id: int) -> LatLon:
        """WGS 84 position of the centre of an obstacle."""
        return self.georeference.geodetic_from_enu(self.enu_of(obstacle_id))[0]


def _local(placed: PlacedObstacle | PlacedFeature, x_m: FloatArray, y_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    cos, sin = math.cos(placed.yaw_rad), math.sin(placed.yaw_rad)
    dx, dy = x_m - placed.x_m, y_m - placed.y_m
    return cos * dx + sin * dy, cos * dy - sin * dx


def grow(street: Street, obstacle_id: int, area_factor: float) -> Street:
    """The street after the footprint of one obstacle has become `area_factor` times as large."""
    placed = street.obstacle(obstacle_id)
    return _with_obstacle(street, replace(placed, shape=placed.shape.grown(area_factor)))


def fill(street: Street, obstacle_id: int) -> Street:
    """The street after one obstacle has been repaired or taken away."""
    return _with_obstacle(street, replace(street.obstacle(obstacle_id), filled=True))


def _with_obstacle(street: Street, changed: PlacedObstacle) -> Street:
    obstacles = tuple(changed if o.obstacle_id == changed.obstacle_id else o for o in street.obstacles)
    return replace(street, obstacles=obstacles)


def first_light_street(seed: int, scans: Sequence[Relief] = ()) -> Street:
    """The demo's street: two potholes, a bump and a broken pallet in the right lane, two parked cars.

    Obstacles lie between x = 215 and 290 m, so that a car coming from x = 0 at 50 km/h can be warned more than ten
    seconds ahead. With `scans` the potholes take those shapes in turn, each kept at its own size.
    """
    rng = np.random.default_rng(seed)
    holes: list[Relief] = [pothole(seed, 0.90, 0.70, 0.12), pothole(seed + 1, 0.65, 0.50, 0.10)]
    if scans:
        holes = [scans[0], scans[1 % len(scans)].grown((0.65 / 0.90) ** 2)]
    places: list[tuple[Kind, float, float, Relief | Debris]] = [
        (Kind.POTHOLE, 218.0, -2.35, holes[0]),
        (Kind.BUMP, 240.0, -1.15, bump(seed + 2, 0.90, 0.60, 0.09)),
        (Kind.DEBRIS, 263.0, -2.75, broken_pallet(seed + 3, 0.80, 0.60, 0.30)),
        (Kind.POTHOLE, 286.0, -1.15, holes[1]),
    ]
    obstacles = tuple(
        PlacedObstacle(number, kind, x + rng.uniform(-2, 2), y + rng.uniform(-0.1, 0.1), rng.uniform(-0.6, 0.6), shape)
        for number, (kind, x, y, shape) in enumerate(places, start=1)
    )
    cars = (
        # Two wheels on the kerb: 12 cm over a track of 1.5 m.
        ParkedCar(231.0, 4.05, -0.005, math.pi, -0.08, (0.20, 0.018, 0.016)),
        ParkedCar(252.0, -4.05, -0.005, 0.0, -0.08, (0.045, 0.085, 0.16)),
    )
    features = [
        PlacedFeature(Feature.PATCH, 176.0, -1.9, 0.0, patch(rng, 2.8, 1.1)),
        PlacedFeature(Feature.MANHOLE, 228.5, -1.8, 0.0, manhole(rng)),
        PlacedFeature(Feature.PATCH, 251.5, 1.6, 0.0, patch(rng, 3.6, 1.3)),
        PlacedFeature(Feature.MANHOLE, 275.0, -2.2, 0.0, manhole(rng)),
        PlacedFeature(Feature.JOINT, 297.0, 0.0, 0.0, joint(6.9)),
    ]
    return Street(seed, obstacles, cars, tuple(features))
