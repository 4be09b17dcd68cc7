"""Recall, precision, calibration and segmentation of the LiDAR detector on courses with exact truth."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from contract.geometry import Kind
from detector.passes.accumulator import RECENT_FRAMES, Accumulator, accumulate
from detector.passes.over_frames import detect_over_frames
from detector.pipeline import detect
from detector.types import DetectedObstacle
from evaluation.lidar_course import Course, Moment, course, drive, in_sensor, in_sight, presets
from evaluation.segmentation import Confusion, confusion
from simulator.streets.street import Roughness

FloatArray = NDArray[np.float64]

DISTANCES_M = (5, 10, 15, 20, 30, 40)
# A trial is a sweep from within this of the distance.
DISTANCE_SLACK_M = 0.7
# A detection whose middle is this near to an obstacle's outline is that obstacle.
NEAR_M = 0.5
# Seeds that nothing was built or fitted with.
TEST_SEEDS = tuple(range(2001, 2009))
MODES = ("1 sweep", "10 sweeps")


@dataclass(frozen=True, slots=True)
class Condition:
    """What a row of the tables was driven with."""

    sensor: str
    range_sd_m: float
    speed_kph: float


@dataclass(slots=True)
class Score:
    """What was counted under one condition.

    `found` and `tried` by (mode, trial's name, distance); `false_alarms` by (mode, kind); `right` and `claimed` by
    (mode, kind); `sureness` by mode pairs of confidence and truth; `hits` by (trial's name, distance) the LiDAR's
    returns from the obstacle in the sweep.
    """

    frames: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    found: dict[tuple[str, str, int], int] = field(default_factory=lambda: defaultdict(int))
    tried: dict[tuple[str, str, int], int] = field(default_factory=lambda: defaultdict(int))
    hits: dict[tuple[str, int], list[int]] = field(default_factory=lambda: defaultdict(list))
    false_alarms: dict[tuple[str, str], int] = field(default_factory=lambda: defaultdict(int))
    claimed: dict[tuple[str, str], int] = field(default_factory=lambda: defaultdict(int))
    sureness: dict[str, list[tuple[float, bool]]] = field(default_factory=lambda: defaultdict(list))
    confusion: Confusion = field(default_factory=Confusion)

    def false_per_frame(self, mode: str) -> float:
        """Detections that are no test obstacle, per sweep."""
        return sum(n for (m, _), n in self.false_alarms.items() if m == mode) / max(self.frames[mode], 1)

    def precision(self, mode: str, kind: str) -> float:
        """Share of the detections of a kind that are an obstacle of its sign; NaN of none."""
        claimed = self.claimed[mode, kind]
        return 1.0 - self.false_alarms[mode, kind] / claimed if claimed else float("nan")

    def calibration_error(self, mode: str) -> float:
        """Expected calibration error (Naeini et al., 2015) over ten bins of confidence."""
        return calibration_error(np.array(self.sureness[mode], dtype=np.float64).reshape(-1, 2))


def calibration_error(sureness: FloatArray) -> float:
    """Mean distance of confidence and share of truth over ten bins, weighted by their size; pairs (N, 2)."""
    gaps = [len(rows) * abs(rows[:, 0].mean() - rows[:, 1].mean()) for rows in reliability(sureness)]
    return float(sum(gaps)) / max(len(sureness), 1)


def reliability(sureness: FloatArray) -> list[FloatArray]:
    """Pairs of confidence and truth (N, 2) in the ten bins of confidence, without the empty ones."""
    bin_of = np.minimum((sureness[:, 0] * 10).astype(np.int64), 9)
    return [sureness[bin_of == k] for k in range(10) if (bin_of == k).any()]


def conditions(quick: bool) -> list[Condition]:
    """Every sensor at 2 cm of range noise; the first also at 1 and 3 cm, and at walking pace in traffic."""
    sensors = list(presets(0.02))
    if quick:
        return [Condition(sensors[0], 0.02, 50.0)]
    noise = [Condition(sensors[0], sd, 50.0) for sd in (0.01, 0.03)]
    return [*(Condition(name, 0.02, 50.0) for name in sensors), *noise, Condition(sensors[0], 0.02, 20.0)]


def run(seeds: Sequence[int], asked: Sequence[Condition]) -> Iterator[tuple[Condition, Score]]:
    """The score of each condition so far, after every drive; a world is built once for all conditions."""
    scores = {condition: Score() for condition in asked}
    for seed in seeds:
        on = course(seed, Roughness.B if seed % 2 else Roughness.C)
        for condition in asked:
            lidar = presets(condition.range_sd_m)[condition.sensor]
            score_drive(scores[condition], on, drive(on, lidar, seed, condition.speed_kph / 3.6))
            yield condition, scores[condition]


def score_drive(score: Score, on: Course, moments: Iterator[Moment]) -> None:
    """Count one drive into a score."""
    state = Accumulator()
    recent_hits: list[NDArray[np.int64]] = []
    for moment in moments:
        detection = detect(moment.sweep)
        state = accumulate(state, moment.sweep, detection)
        centres, seen = in_sensor(moment.street_from_sensor, on), in_sight(moment.street_from_sensor, on)
        hits = np.bincount(np.maximum(moment.truth.obstacle_id, 0), minlength=len(on.obstacles) + 1)[1:]
        recent_hits = [*recent_hits, hits][-RECENT_FRAMES:]
        score.confusion = score.confusion + confusion(moment, detection.labels, on)
        _count(score, MODES[0], on, detection.obstacles, centres, seen)
        _count_hits(score, on, hits, centres, seen)
        if len(state.recent) == RECENT_FRAMES:
            together = detect_over_frames(state, moment.sweep, detection)
            _count(score, MODES[1], on, together, centres, seen)


def _count(
    score: Score,
    mode: str,
    on: Course,
    obstacles: Sequence[DetectedObstacle],
    centres_m: FloatArray,
    seen: NDArray[np.bool_],
) -> None:
    score.frames[mode] += 1
    found = np.zeros(len(on.obstacles), dtype=bool)
    for obstacle in obstacles:
        match = in_place(obstacle, on, centres_m)
        score.claimed[mode, obstacle.kind.value] += 1
        score.sureness[mode].append((obstacle.confidence, match is not None))
        if match is None:
            score.false_alarms[mode, obstacle.kind.value] += 1
        else:
            found[match] = True
    for k, distance in _trials(centres_m, seen):
        score.tried[mode, on.trials[k].name, distance] += 1
        score.found[mode, on.trials[k].name, distance] += bool(found[k])


def _count_hits(
    score: Score, on: Course, hits: NDArray[np.int64], centres_m: FloatArray, seen: NDArray[np.bool_]
) -> None:
    for k, distance in _trials(centres_m, seen):
        score.hits[on.trials[k].name, distance].append(int(hits[k]))


def _trials(centres_m: FloatArray, seen: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """Obstacles ahead in plain sight, and the distance of the tables that they are at."""
    away = np.hypot(centres_m[:, 0], centres_m[:, 1])
    for k in np.flatnonzero(seen & (centres_m[:, 0] > 0.0)):
        for distance in DISTANCES_M:
            if abs(away[k] - distance) < DISTANCE_SLACK_M:
                yield int(k), distance


def in_place(obstacle: DetectedObstacle, on: Course, centres_m: FloatArray) -> int | None:
    """Which test obstacle of the same sign a detection is, if any; `centres_m` (K, 3) are theirs in its frame."""
    away = np.hypot(*(centres_m[:, :2] - obstacle.centre_m[:2]).T)
    for k in np.argsort(away):
        placed = on.obstacles[k]
        same_sign = (placed.kind is Kind.POTHOLE) == obstacle.kind.is_negative
        if same_sign and away[k] < 0.5 * placed.shape.length_m + NEAR_M:
            return int(k)
    return None
