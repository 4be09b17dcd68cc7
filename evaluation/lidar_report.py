"""The LiDAR scores as tables, as JSON and as pictures."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from contract.geometry import Kind
from evaluation.lidar import DISTANCES_M, MODES, Condition, Score, reliability
from evaluation.lidar_course import TRIALS

Scores = Mapping[Condition, Score]


def title_of(condition: Condition) -> str:
    """A condition in words."""
    return f"{condition.sensor}, {condition.range_sd_m * 100:.0f} cm of range noise, {condition.speed_kph:.0f} km/h"


def markdown(scores: Scores) -> str:
    """All tables."""
    return "\n\n".join(_tables(condition, score) for condition, score in scores.items()) + "\n"


def _tables(condition: Condition, score: Score) -> str:
    parts = [f"### {title_of(condition)}"]
    for mode in MODES:
        kinds = ", ".join(
            f"{kind.value} {100 * score.precision(mode, kind.value):.1f} % of {score.claimed[mode, kind.value]}"
            for kind in Kind
            if score.claimed[mode, kind.value]
        )
        parts.append(
            f"{mode}: found / tried; {score.false_per_frame(mode):.3f} false a sweep of {score.frames[mode]}; "
            f"precision {kinds}; calibration error {score.calibration_error(mode):.3f}\n\n" + _recall(score, mode)
        )
    shares = score.confusion.intersection_over_union()
    parts.append(
        "Intersection over union: " + ", ".join(f"{name} {100 * share:.1f} %" for name, share in shares.items())
    )
    return "\n\n".join(parts)


def _recall(score: Score, mode: str) -> str:
    head = "| obstacle (returns in a sweep) | " + " | ".join(f"{d} m" for d in DISTANCES_M) + " |"
    lines = [head, "|---|" + "---|" * len(DISTANCES_M)]
    for trial in TRIALS:
        cells = []
        for distance in DISTANCES_M:
            key = (mode, trial.name, distance)
            hits = score.hits[trial.name, distance]
            cells.append(f"{score.found[key]}/{score.tried[key]} ({np.median(hits):.0f})" if hits else "")
        lines.append(f"| {trial.name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def as_json(scores: Scores) -> str:
    """Everything that was counted."""
    return json.dumps([_as_dict(condition, score) for condition, score in scores.items()], indent=1) + "\n"


def _as_dict(condition: Condition, score: Score) -> dict[str, object]:
    return {
        "sensor": condition.sensor,
        "range_sd_m": condition.range_sd_m,
        "speed_kph": condition.speed_kph,
        "modes": {mode: _mode(score, mode) for mode in MODES},
        "intersection_over_union": score.confusion.intersection_over_union(),
    }


def _mode(score: Score, mode: str) -> dict[str, object]:
    claimed = [kind.value for kind in Kind if score.claimed[mode, kind.value]]
    return {
        "frames": score.frames[mode],
        "false_per_frame": score.false_per_frame(mode),
        "calibration_error": score.calibration_error(mode),
        "precision": {kind: score.precision(mode, kind) for kind in claimed},
        "recall": {
            trial.name: {
                str(distance): [score.found[mode, trial.name, distance], score.tried[mode, trial.name, distance]]
                for distance in DISTANCES_M
            }
            for trial in TRIALS
        },
    }


def draw(scores: Scores, folder: Path) -> None:
    """`recall.png` (found against distance) and `reliability.png` (truth against confidence) of the first condition."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    condition, score = next(iter(scores.items()))
    figure, axes = plt.subplots(1, 2, figsize=(11, 4), sharey=True, layout="constrained")
    for axis, mode in zip(axes, MODES, strict=True):
        for trial in TRIALS:
            tried = np.array([score.tried[mode, trial.name, d] for d in DISTANCES_M])
            found = np.array([score.found[mode, trial.name, d] for d in DISTANCES_M])
            axis.plot(DISTANCES_M, 100 * found / np.maximum(tried, 1), marker="o", label=trial.name)
        axis.set(title=mode, xlabel="distance [m]", ylabel="found [%]" if axis is axes[0] else "")
        axis.grid(alpha=0.3)
    axes[1].legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    figure.suptitle(title_of(condition))
    figure.savefig(folder / "recall.png", dpi=120)
    plt.close(figure)
    figure, axis = plt.subplots(figsize=(4.5, 4.2), layout="constrained")
    axis.plot([0.5, 1], [0.5, 1], color="0.7", linewidth=1)
    for mode in MODES:
        pairs = np.concatenate([np.array(s.sureness[mode], dtype=float).reshape(-1, 2) for s in scores.values()])
        rows = reliability(pairs)
        axis.plot([r[:, 0].mean() for r in rows], [r[:, 1].mean() for r in rows], marker="o", label=mode)
    axis.set(xlabel="confidence", ylabel="share that are obstacles", title="all sensors and conditions")
    axis.grid(alpha=0.3)
    axis.legend()
    figure.savefig(folder / "reliability.png", dpi=120)
    plt.close(figure)
