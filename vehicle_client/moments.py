"""When a track is measured and told: once it is about to be passed if nobody knew it, and after it was passed. Pure.

A new obstacle is worth telling before it is passed: whoever follows closely is helped. Its shape is best afterwards,
when both rims were seen; it is told again only if it changed by more than the server's rule would take for a change.
What the server knows already is told once, as well as it can be (docs/decisions/0016).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from contract.geometry import Sign
from contract.obstacle import ObstacleFeature
from detector.types import DetectedObstacle
from vehicle_client.alignment import Alignment
from vehicle_client.frames import Matrix, apply, inverse
from vehicle_client.positioning.pose import Pose
from vehicle_client.posts import is_post
from vehicle_client.reporting import known_place
from vehicle_client.tracking import Track

ABOUT_TO_PASS_M = 6.0
"""Nearer than this ahead most LiDARs on a roof see the road no more: what the front shows has been shown."""

PASSED_M = 12.0
"""An obstacle this far behind has been seen from both sides: hits beyond 12 m no longer sharpen its box."""

GIVEN_UP_M = 18.0
"""Without a place in the world an obstacle waits for one until it lies this far behind; then its hits are forgotten
(30 m of memory less 12 m of range)."""

GOOD_LN_AREA_SD = 0.25
"""An area known worse than by a quarter is not told before the obstacle is passed: it would only be corrected."""

LEAST_RELIEF_M = 0.03
"""What is measured as flatter than this is told to nobody: single sweeps take texture, gutters and patches of
2 to 2.7 cm for more than they are (`headsup evaluate told`), and wheels feel little of it."""

MOST_REPORTS = 3
"""Of one obstacle in one pass: before it, after it, and at the end of a drive that ends beside it."""

CHANGED_RATIO, CHANGED_RELIEF_RATIO = 1.15, 1.25
"""Of area, length and width, and of depth or height, as the server's rule has them; to either side."""

MOVED_M, MOVED_SDS = 0.3, 3.0
"""A centre that moved less than this, or within its own error, tells nobody anything."""

KNOWN_M = 4.0
"""A track and a mapped obstacle of one sign nearer than this are one: 3 sigma of two satellite positions."""


class Moment(Enum):
    """Where the car is as it measures an obstacle."""

    APPROACH = "about to be passed"
    PASSED = "passed"
    END = "the drive ends"


@dataclass(frozen=True, slots=True)
class Due:
    """A track whose moment has come."""

    track: Track
    moment: Moment


def due(
    tracks: Sequence[Track], known: frozenset[int], odom_from_vehicle: Matrix, *, is_placed: bool, at_end: bool
) -> list[Due]:
    """Believed tracks of what stands still that are to be measured now; `known` are numbers of those the map has.

    While the car has no place (`is_placed`) it waits for one as long as the hits are kept.
    """
    vehicle_from_odom = inverse(odom_from_vehicle)
    found = []
    for track in tracks:
        if track.confirmed and track.is_static and track.reports < MOST_REPORTS:
            ahead_m = float(apply(vehicle_from_odom, track.centre_odom_m)[0])
            if not track.was_passed and (at_end or ahead_m < -(PASSED_M if is_placed else GIVEN_UP_M)):
                found.append(Due(track, Moment.END if at_end else Moment.PASSED))
            elif (
                is_placed
                and not track.was_approached
                and track.track_id not in known
                and 0 <= ahead_m < ABOUT_TO_PASS_M
            ):
                found.append(Due(track, Moment.APPROACH))
    return found


def after(due: Due, told: DetectedObstacle | None) -> Track:
    """The track after its moment; `told` is what went into a report."""
    track = due.track
    return replace(
        track,
        was_approached=True,
        was_passed=track.was_passed or due.moment is not Moment.APPROACH,
        reports=track.reports + (told is not None),
        told=track.told if told is None else told,
    )


def known_tracks(
    tracks: Sequence[Track], features: Sequence[ObstacleFeature], pose: Pose, alignment: Alignment
) -> frozenset[int]:
    """Numbers of the tracks at whose places the map has an obstacle of their sign."""
    places = [(f.properties.sign is Sign.NEGATIVE, known_place(f, pose, alignment).centre_odom_m) for f in features]
    return frozenset(
        t.track_id
        for t in tracks
        if any(
            is_negative == t.is_negative and np.linalg.norm((place - t.centre_odom_m)[:2]) < KNOWN_M
            for is_negative, place in places
        )
    )


def is_to_be_told(due: Due, measured: DetectedObstacle) -> bool:
    """Whether a measurement is of an obstacle for others, and says something that was not told in this pass."""
    if why_untold(due.track, measured) is not None:
        return False
    told = due.track.told
    if told is None:
        return due.moment is not Moment.APPROACH or measured.ln_area_sd <= GOOD_LN_AREA_SD
    return has_changed(told, measured)


def why_untold(track: Track, measured: DetectedObstacle) -> str | None:
    """In a word why nobody is told of what was measured, None of an obstacle: a post beside the lane; flat; doubtful,
    since the searches seldom found it; behind, since the drive began beyond it, where rings lie far apart."""
    if is_post(measured.kind, track.beside_m, measured.length_m, measured.width_m, measured.relief_m):
        return "post"
    if measured.relief_m < LEAST_RELIEF_M:
        return "flat"
    if track.is_doubtful:
        return "doubtful"
    return None if track.was_ahead else "behind"


def has_changed(told: DetectedObstacle, measured: DetectedObstacle) -> bool:
    """Whether two measurements of a pass differ by more than the rule's limits, in shape or place; NaN is no change."""
    areas = told.length_m * told.width_m, measured.length_m * measured.width_m
    lengths, widths = (told.length_m, measured.length_m), (told.width_m, measured.width_m)
    if any(_beyond(*pair, CHANGED_RATIO) for pair in (areas, lengths, widths)):
        return True
    if _beyond(told.relief_m, measured.relief_m, CHANGED_RELIEF_RATIO):
        return True
    moved_m = float(np.linalg.norm((measured.centre_m - told.centre_m)[:2]))
    variances_m2 = np.trace(told.centre_covariance_m2) + np.trace(measured.centre_covariance_m2)
    return moved_m > max(MOVED_M, MOVED_SDS * math.sqrt(float(variances_m2) / 2))


def _beyond(a: float, b: float, ratio: float) -> bool:
    return max(a, b) > ratio * min(a, b)
