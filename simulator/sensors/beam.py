"""The width of a laser beam: at an edge it meets two surfaces, and the sensor reports a mixture or one of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np
from numba import njit
from numpy.typing import NDArray

from simulator.sensors.returns import received_power

if TYPE_CHECKING:
    from simulator.world import Hits, World

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]

EDGE_M = 0.05
"""A neighbour this far off a hit's tangent plane is worth a closer look; half of a kerb, more than road texture."""

SUB_RAYS = 6
CENTRE_WEIGHT, RIM_WEIGHT = 1 / 2, 1 / 12
"""Cubature of degree 5 over a Gaussian beam: its centre, and six rays on the circle where the intensity has fallen to
1/e^2 (Stroud, Approximate Calculation of Multiple Integrals, 1971, formula E2^r2 5-1)."""


@dataclass(frozen=True, slots=True)
class Beam:
    """Full angle between the 1/e^2 edges, and the least distance in depth of two echoes that are told apart.

    Echoes closer than that are one, whose range is the mean weighted by received power; of several, the strongest is
    reported, Velodyne's ordinary return mode (HDL-64E S3 manual, "Multiple Return Status"). Sub-rays for the beam's
    width follow Winiwarter et al., Virtual laser scanning with HELIOS++, Remote Sensing of Environment 269, 2022.
    """

    divergence_rad: float
    echo_separation_m: float

    def __post_init__(self) -> None:
        if not (0 < self.divergence_rad < 0.1 and 0 < self.echo_separation_m < math.inf):
            raise ValueError("a beam's divergence is between 0 and 0.1 rad, its echo separation positive")


@dataclass(frozen=True, slots=True)
class Shots:
    """The rays of a turn, frame `street`: (N, 3) origins and unit directions by column, then ring; times (N,).

    Nothing beyond `range_m` is looked at.
    """

    origins_m: Float32Array
    rays: Float32Array
    time_s: FloatArray
    channels: int
    range_m: float
    ignored_mover: int


def spread(world: World, beam: Beam, shots: Shots, hits: Hits, power: Float32Array) -> tuple[Hits, Float32Array]:
    """Hits and received power (N,) of beams with a width, from those of their central rays."""
    within = np.where(hits.distance <= shots.range_m, hits.distance, np.float32(np.inf))
    edges = np.flatnonzero(_at_edges(shots.origins_m, shots.rays, within, hits.normal, shots.channels))
    if not len(edges):
        return hits, power
    origins = np.repeat(shots.origins_m[edges], SUB_RAYS, axis=0)
    rays = _rim_rays(shots.rays[edges], math.tan(beam.divergence_rad / 2))
    rim = world.cast(origins, rays, np.repeat(shots.time_s[edges], SUB_RAYS), shots.ignored_mover, shots.range_m)
    rim_power = received_power(rim, rays, world.surfaces(rim))
    distance, strength, winner = _strongest_echo(
        hits.distance[edges], power[edges], rim.distance, rim_power, np.float32(beam.echo_separation_m)
    )
    power = power.copy()
    power[edges] = strength
    return _with_winners(hits, rim, edges, distance, winner), power


def _with_winners(
    hits: Hits, rim: Hits, edges: NDArray[np.intp], distance: Float32Array, winner: NDArray[np.intp]
) -> Hits:
    """The central hits, where a rim ray dominated the echo with what that ray hit; `winner` -1 is the centre."""
    changed, source = edges[winner >= 0], winner[winner >= 0]
    mixed = {column.name: getattr(hits, column.name).copy() for column in fields(hits)}
    for name, values in mixed.items():
        values[changed] = getattr(rim, name)[source]
    mixed["distance"][edges] = distance
    return replace(hits, **mixed)


@njit(cache=True, nogil=True)
def _at_edges(
    origins: Float32Array, rays: Float32Array, distance: Float32Array, normal: Float32Array, channels: int
) -> NDArray[np.bool_]:
    """Whether a beam's next one by ring or by azimuth does not lie on its surface, (N,)."""
    count = len(rays)
    edge = np.zeros(count, dtype=np.bool_)
    for i in range(count):
        for across in range(2):
            if across == 0 and (i + 1) % channels == 0:
                continue
            j = i + 1 if across == 0 else (i + channels) % count
            if edge[i] and edge[j]:
                continue
            hit_i, hit_j = math.isfinite(distance[i]), math.isfinite(distance[j])
            if hit_i and hit_j:
                off_i = off_j = np.float32(0.0)
                for k in range(3):
                    apart = origins[j, k] + rays[j, k] * distance[j] - origins[i, k] - rays[i, k] * distance[i]
                    off_i += normal[i, k] * apart
                    off_j += normal[j, k] * apart
                differ = bool(max(abs(off_i), abs(off_j)) > EDGE_M)
            else:
                differ = hit_i != hit_j
            if differ:
                edge[i] = edge[j] = True
    return edge


@njit(cache=True, nogil=True)
def _rim_rays(rays: Float32Array, slope: float) -> Float32Array:
    """Unit directions (6 N, 3) about each of (N, 3), `slope` away from it."""
    out = np.empty((len(rays) * SUB_RAYS, 3), dtype=np.float32)
    cosines = np.cos(np.arange(SUB_RAYS) * (2 * math.pi / SUB_RAYS))
    sines = np.sin(np.arange(SUB_RAYS) * (2 * math.pi / SUB_RAYS))
    shrink = 1 / math.sqrt(1 + slope * slope)
    for i in range(len(rays)):
        x, y, z = rays[i, 0], rays[i, 1], rays[i, 2]
        # Any vector not along the ray gives the first of two directions across it.
        if abs(z) < 0.9:
            length = math.sqrt(x * x + y * y)
            ux, uy, uz = -y / length, x / length, 0.0
        else:
            length = math.sqrt(y * y + z * z)
            ux, uy, uz = 0.0, -z / length, y / length
        vx, vy, vz = y * uz - z * uy, z * ux - x * uz, x * uy - y * ux
        for k in range(SUB_RAYS):
            a, b = slope * cosines[k], slope * sines[k]
            out[i * SUB_RAYS + k, 0] = (x + a * ux + b * vx) * shrink
            out[i * SUB_RAYS + k, 1] = (y + a * uy + b * vy) * shrink
            out[i * SUB_RAYS + k, 2] = (z + a * uz + b * vz) * shrink
    return out


@njit(cache=True, nogil=True)
def _strongest_echo(
    centre_m: Float32Array, centre_power: Float32Array, rim_m: Float32Array, rim_power: Float32Array, apart_m: float
) -> tuple[Float32Array, Float32Array, NDArray[np.intp]]:
    """Range, power and dominating rim ray (index into the rim's, -1 the centre) of the strongest echo of each beam.

    Range is inf and power zero where nothing comes back.
    """
    count = len(centre_m)
    range_m = np.full(count, np.inf, dtype=np.float32)
    power = np.zeros(count, dtype=np.float32)
    winner = np.full(count, -1, dtype=np.intp)
    distance, strength = np.empty(SUB_RAYS + 1), np.empty(SUB_RAYS + 1)
    order = np.empty(SUB_RAYS + 1, dtype=np.intp)
    for i in range(count):
        distance[0], strength[0] = centre_m[i], centre_power[i] * CENTRE_WEIGHT
        for k in range(SUB_RAYS):
            distance[k + 1] = rim_m[i * SUB_RAYS + k]
            strength[k + 1] = rim_power[i * SUB_RAYS + k] * RIM_WEIGHT
        for k in range(SUB_RAYS + 1):  # insertion: seven values are too few for a sort that allocates
            place = k
            while place > 0 and distance[order[place - 1]] > distance[k]:
                order[place] = order[place - 1]
                place -= 1
            order[place] = k
        total = mean = best = last = 0.0
        best_ray = -1
        for step in range(SUB_RAYS + 1):
            k = int(order[step])
            if not math.isfinite(distance[k]):
                break
            if total > 0 and distance[k] - last > apart_m:
                total = mean = best = 0.0
            last = distance[k]
            total += strength[k]
            mean += strength[k] * distance[k]
            if strength[k] > best:
                best, best_ray = strength[k], k
            if total > power[i]:
                power[i], range_m[i] = total, mean / total
                winner[i] = -1 if best_ray == 0 else i * SUB_RAYS + best_ray - 1
    return range_m, power, winner
