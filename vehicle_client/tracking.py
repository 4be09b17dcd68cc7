"""One obstacle is seen in many frames: tracks in `odom`, as a pure fold over the detections of each frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from detector.types import DetectedObstacle, ObstacleKind
from vehicle_client.frames import Matrix, Vector, apply

GATE_M = 1.2
"""A detection joins a track nearer than this: above a frame's error of a centre, below the gap of two holes."""

CONFIRMED_AFTER = 3
"""Sightings that make a track believed; a single frame's false cluster does not repeat in `odom`."""

STATIC_M = 1.0
"""Farther than this no centre wanders by seeing more of the obstacle as the car comes nearer; whoever walks across a
street does so in a second."""

AVERAGED = 3
"""Centres that are averaged at either end before they are compared."""

LOOKED_FROM_M = 10.0
"""Nearer than this a LiDAR's rings lie close enough to show a hole when nothing hides it."""

LEAST_SHARE, SURE_AFTER = 1 / 6, 5
"""Fewer than a handful of sightings do for no more searches from near the place than this. On simulated streets, at
50 km/h, the smallest holes (35 cm x 30 cm, 5 cm deep) are found by a fifth of them and more, at walking pace also by
fewer, but often; on a recorded drive along a sound road what three sightings made believed was found by 0.08 to 0.15 of
them (`headsup evaluate told`)."""

FORGET_M = 40.0
"""Tracks this far behind the car are dropped: nothing there is measured any more."""

MOST_SEARCHES = 280
"""As many sweeps as the accumulator keeps of a car that drives in circles."""


@dataclass(frozen=True, slots=True)
class Track:
    """One obstacle over frames. `first_range_m` is the distance at which it was first seen."""

    track_id: int
    centre_odom_m: Vector
    is_negative: bool
    bump_votes: int
    debris_votes: int
    length_m: float
    width_m: float
    relief_m: float
    yaw_rad: float
    sightings: int
    first_stamp_s: float
    first_range_m: float
    last_stamp_s: float
    looks: int
    """Searches from within `LOOKED_FROM_M` of it, whether they found it or not, also before they first did."""
    was_ahead: bool
    """Whether it lay ahead of the sensor in any search, whether that found it or not."""
    first_m: tuple[Vector, ...]
    """The first centres (2,), as they were detected."""
    latest_m: tuple[Vector, ...]
    """The latest ones."""
    beside_m: float = 0.0
    """How far to the side of the car it lay when the car came by; until then, as it lies now."""
    was_approached: bool = False
    """Whether it was measured as it was about to be passed."""
    was_passed: bool = False
    """Whether it was measured after it was passed, or at the end."""
    reports: int = 0
    """How often it was told in this pass."""
    told: DetectedObstacle | None = None
    """As it was told last."""

    @property
    def kind(self) -> ObstacleKind:
        """What most frames took it for: a single one easily confuses bump and debris."""
        if self.is_negative:
            return ObstacleKind.POTHOLE
        return ObstacleKind.BUMP if self.bump_votes >= self.debris_votes else ObstacleKind.DEBRIS

    @property
    def confirmed(self) -> bool:
        """Whether it was seen often enough to be believed."""
        return self.sightings >= CONFIRMED_AFTER

    @property
    def is_doubtful(self) -> bool:
        """Whether it was seen a few times only, in too small a share of the searches from near it."""
        return self.sightings < min(SURE_AFTER, LEAST_SHARE * self.looks)

    @property
    def is_static(self) -> bool:
        """Whether it stands where it was first seen: what moves is no obstacle of the road."""
        # What drives away from its track is seen three times: then the first centre is held against the last.
        number = max(1, min(AVERAGED, self.sightings // 2))
        moved_m = np.mean(self.latest_m[-number:], axis=0) - np.mean(self.first_m[:number], axis=0)
        return float(np.linalg.norm(moved_m)) <= STATIC_M


@dataclass(frozen=True, slots=True)
class Search:
    """From where in `odom` the road was searched: the sensor's place (2,), and its forward axis (2,)."""

    place_m: Vector
    forward: Vector


@dataclass(frozen=True, slots=True)
class Tracks:
    """All tracks of a drive near the car, the number the next one gets, and the searches of the last `FORGET_M`."""

    tracks: tuple[Track, ...] = ()
    next_id: int = 1
    searches: tuple[Search, ...] = ()

    def with_track(self, track: Track) -> Tracks:
        """The same tracks, with one in a new value."""
        return replace(self, tracks=tuple(track if t.track_id == track.track_id else t for t in self.tracks))


def update(state: Tracks, detected: Sequence[DetectedObstacle], odom_from_sensor: Matrix, stamp_s: float) -> Tracks:
    """Join the detections of one frame (in `sensor`) to the nearest tracks of the same sign, one to one."""
    here = Search(odom_from_sensor[:2, 3].copy(), odom_from_sensor[:2, 0].copy())
    near = [search for search in state.searches if np.linalg.norm(search.place_m - here.place_m) < FORGET_M]
    searches = (*near, here)[-MOST_SEARCHES:]
    tracks = {track.track_id: _passed_by(_looked_at(track, here), odom_from_sensor) for track in state.tracks}
    next_id = state.next_id
    centres = [apply(odom_from_sensor, obstacle.centre_m) for obstacle in detected]
    free, waiting = set(range(len(detected))), set(tracks)
    for _, track_id, index in sorted(_pairs(state.tracks, detected, centres)):
        if index in free and track_id in waiting:
            tracks[track_id] = _joined(tracks[track_id], detected[index], centres[index], odom_from_sensor, stamp_s)
            free.remove(index)
            waiting.remove(track_id)
    for index in sorted(free):
        begun = _begun(next_id, detected[index], centres[index], odom_from_sensor, stamp_s)
        for search in searches:
            begun = _looked_at(begun, search)
        tracks[next_id] = begun
        next_id += 1
    kept = tuple(t for t in tracks.values() if _ahead_m(t.centre_odom_m, odom_from_sensor) > -FORGET_M)
    return Tracks(kept, next_id, searches)


def _pairs(
    tracks: Sequence[Track], detected: Sequence[DetectedObstacle], centres: Sequence[Vector]
) -> list[tuple[float, int, int]]:
    pairs = []
    for track in tracks:
        for index, (obstacle, centre) in enumerate(zip(detected, centres, strict=True)):
            distance_m = float(np.linalg.norm(centre[:2] - track.centre_odom_m[:2]))
            if distance_m < GATE_M and obstacle.kind.is_negative == track.is_negative:
                pairs.append((distance_m, track.track_id, index))
    return pairs


def _begun(
    track_id: int, obstacle: DetectedObstacle, centre: Vector, odom_from_sensor: Matrix, stamp_s: float
) -> Track:
    return Track(
        track_id=track_id,
        centre_odom_m=centre,
        is_negative=obstacle.kind.is_negative,
        bump_votes=int(obstacle.kind is ObstacleKind.BUMP),
        debris_votes=int(obstacle.kind is ObstacleKind.DEBRIS),
        length_m=obstacle.length_m,
        width_m=obstacle.width_m,
        relief_m=obstacle.relief_m,
        yaw_rad=_yaw_in_odom(obstacle, odom_from_sensor),
        sightings=1,
        first_stamp_s=stamp_s,
        first_range_m=float(np.hypot(obstacle.centre_m[0], obstacle.centre_m[1])),
        last_stamp_s=stamp_s,
        looks=0,
        was_ahead=False,
        first_m=(centre[:2],),
        latest_m=(centre[:2],),
        beside_m=abs(float(obstacle.centre_m[1])),
    )


def _joined(
    track: Track, obstacle: DetectedObstacle, centre: Vector, odom_from_sensor: Matrix, stamp_s: float
) -> Track:
    # Half and half: on the approach the latest frame is the nearest and therefore the best.
    return replace(
        track,
        centre_odom_m=(track.centre_odom_m + centre) / 2,
        bump_votes=track.bump_votes + (obstacle.kind is ObstacleKind.BUMP),
        debris_votes=track.debris_votes + (obstacle.kind is ObstacleKind.DEBRIS),
        length_m=(track.length_m + obstacle.length_m) / 2,
        width_m=(track.width_m + obstacle.width_m) / 2,
        relief_m=(track.relief_m + obstacle.relief_m) / 2,
        yaw_rad=_yaw_in_odom(obstacle, odom_from_sensor),
        sightings=track.sightings + 1,
        last_stamp_s=stamp_s,
        first_m=(*track.first_m, centre[:2])[:AVERAGED],
        latest_m=(*track.latest_m, centre[:2])[-AVERAGED:],
    )


def _looked_at(track: Track, search: Search) -> Track:
    """The track after a search."""
    away_m = track.centre_odom_m[:2] - search.place_m
    is_near, is_ahead = float(np.linalg.norm(away_m)) <= LOOKED_FROM_M, float(away_m @ search.forward) >= 0
    return replace(track, looks=track.looks + is_near, was_ahead=track.was_ahead or is_ahead)


def _passed_by(track: Track, odom_from_sensor: Matrix) -> Track:
    if _ahead_m(track.centre_odom_m, odom_from_sensor) < 0:
        return track
    to_left_m = float((track.centre_odom_m - odom_from_sensor[:3, 3]) @ odom_from_sensor[:3, 1])
    return replace(track, beside_m=abs(to_left_m))


def _yaw_in_odom(obstacle: DetectedObstacle, odom_from_sensor: Matrix) -> float:
    turn = np.arctan2(odom_from_sensor[1, 0], odom_from_sensor[0, 0])
    return float((obstacle.yaw_rad + turn) % np.pi)


def _ahead_m(point_odom_m: Vector, odom_from_sensor: Matrix) -> float:
    return float((point_odom_m - odom_from_sensor[:3, 3]) @ odom_from_sensor[:3, 0])
