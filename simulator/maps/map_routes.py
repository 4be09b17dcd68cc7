"""Routes through the lanes of a map: lane after lane as traffic may go on, and the line that is driven."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from simulator.maps.opendrive import LaneKey, OpenDriveLane, OpenDriveRoad
from simulator.streets.trajectory import Path

FloatArray = NDArray[np.float64]

NARROWEST_M = 2.2
"""A car with its mirrors; where a lane tapers to less, nobody drives."""

WIDEST_GAP_M, STEPLESS_M = 1.0, 0.05
"""Lanes whose ends lie farther apart are not connected, whatever the map says; smaller steps are rounded off."""

ROUNDED_M = 6.0
"""Over this length on both sides: 1 m in 12 m is a lane change in town."""

CLOSE_M = 0.25
"""Points closer together than this would bend the line by the rounding of their coordinates."""

MOST_STEPS = 4_000
"""Of a search: the longest way without a repetition is not to be found in a city, one that is long enough is."""


class Lanes:
    """The lanes of some roads that cars can drive, and where each leads on these roads."""

    def __init__(self, roads: Sequence[OpenDriveRoad]) -> None:
        self._lanes = {lane.key: lane for road in roads for lane in road.lanes if _is_driven(lane)}
        self._connecting = {road.road_id for road in roads if road.junction_id != -1}
        self._on = {key: self._continued(lane) for key, lane in self._lanes.items()}
        self._length_m = {key: _length(lane.centre_m) for key, lane in self._lanes.items()}

    @property
    def starts(self) -> list[LaneKey]:
        """Where a route may begin: every lane outside junctions, in the map's order."""
        return [key for key in self._lanes if key.road_id not in self._connecting]

    def route(
        self, rng: np.random.Generator, start: LaneKey, length_m: float, taken: Collection[LaneKey] = ()
    ) -> list[LaneKey]:
        """Lanes from a start on, none twice, `length_m` long or as long as was found; those not `taken` come first."""
        way, driven = [start], [self._length_m[start]]
        choices = [self._choices(rng, way, taken)]
        best, longest = [start], driven[0]
        for _ in range(MOST_STEPS):
            if longest >= length_m or not choices:
                break
            if not choices[-1]:
                for stack in (way, driven, choices):
                    stack.pop()
                continue
            way.append(choices[-1].pop())
            driven.append(driven[-1] + self._length_m[way[-1]])
            choices.append(self._choices(rng, way, taken))
            if driven[-1] > longest:
                best, longest = list(way), driven[-1]
        return best

    def path(self, route: Sequence[LaneKey]) -> Path:
        """The line along a route."""
        points, slopes = _joined([self._lanes[key] for key in route])
        return Path(points, slopes)

    def least_width(self, route: Sequence[LaneKey]) -> float:
        """Width of the narrowest place of a route."""
        return min(float(self._lanes[key].width_m.min()) for key in route)

    def _choices(self, rng: np.random.Generator, way: Sequence[LaneKey], taken: Collection[LaneKey]) -> list[LaneKey]:
        """Where a way can go on without driving a lane twice, to be taken from the end."""
        on = self._on[way[-1]]
        shuffled = [on[index] for index in rng.permutation(len(on))]
        return sorted((key for key in shuffled if key not in way), key=lambda key: key not in taken)

    def _continued(self, lane: OpenDriveLane) -> tuple[LaneKey, ...]:
        here = _travelled(lane)[0][-1]
        known = [self._lanes[key] for key in lane.successors if key in self._lanes]
        return tuple(on.key for on in known if np.linalg.norm(_travelled(on)[0][0] - here) < WIDEST_GAP_M)


def _is_driven(lane: OpenDriveLane) -> bool:
    return lane.kind in ("driving", "bidirectional") and float(lane.width_m.min()) >= NARROWEST_M


def _travelled(lane: OpenDriveLane) -> tuple[FloatArray, FloatArray]:
    """Points (K, 3) in the direction of travel, and the rise to the left (K,) there."""
    slope = np.tan(lane.superelevation_rad)
    return (lane.centre_m, slope) if lane.travels_along_s else (lane.centre_m[::-1], -slope[::-1])


def _joined(lanes: Sequence[OpenDriveLane]) -> tuple[FloatArray, FloatArray]:
    """Points and cross slopes of lanes in a row, without points that lie too close, steps between lanes rounded off."""
    points, slopes = _travelled(lanes[0])
    for lane in lanes[1:]:
        more, more_slopes = _travelled(lane)
        cut = ROUNDED_M if np.linalg.norm(more[0] - points[-1]) > STEPLESS_M else CLOSE_M / 2
        kept = _distances(points)[-1] - _distances(points) >= cut
        kept[0] = True
        on = _distances(more) >= cut
        on[-1] = True
        points = np.concatenate([points[kept], more[on]])
        slopes = np.concatenate([slopes[kept], more_slopes[on]])
    return points, slopes


def _distances(points_m: FloatArray) -> FloatArray:
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points_m[:, :2], axis=0).T))])


def _length(points_m: FloatArray) -> float:
    return float(_distances(points_m)[-1])
