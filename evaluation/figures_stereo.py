"""The paper's figure of stereo frames: a row of disparity, truth and estimate for each."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray

from evaluation.figure_style import HEAT, INK, new_figure, plain, save
from evaluation.stereo import frames_in, matched_pixels
from evaluation.table2 import ScoredFrame, score_frames

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]

HIT, MISSED, TOO_MUCH = (0.18, 0.65, 0.28), (0.95, 0.76, 0.0), (0.94, 0.14, 0.10)
# Of the matched pixels; matches far off the road would take the colours.
SHADES = (0.01, 0.999)


def first_frames(folder: Path) -> list[ScoredFrame]:
    """The first frame of each data set under a folder, with its estimate. Raises StereoError."""
    first = {files[0].parent.name: files for files in reversed(frames_in(folder))}
    return list(score_frames(first[dataset] for dataset in sorted(first)))


def draw_stereo(path: Path, frames: list[ScoredFrame]) -> None:
    """Disparity, truth, estimate and their difference, a row a frame."""
    height = 0.95 + 2.1 * len(frames)
    subtitle = (
        "green: found and labelled; yellow: labelled only; red: found only; disparity: red high, blue low, black no "
        "match (frames: Fan et al.)"
    )
    figure = new_figure(14.0, height, "Potholes in real stereo frames", subtitle)
    grid = figure.add_gridspec(
        len(frames), 4, left=0.03, right=0.995, top=1.0 - 0.95 / height, bottom=0.01, wspace=0.02, hspace=0.04
    )
    for at, scored in enumerate(frames):
        truth, mask = scored.frame.label, scored.mask
        images = (_heat(scored.frame.disparity), _masked(truth), _masked(mask), _difference(truth, mask))
        titles = ("transformed disparity", "truth", "estimate, method surface", "difference")
        for column, (image, title) in enumerate(zip(images, titles, strict=True)):
            axes = figure.add_subplot(grid[at, column])
            axes.imshow(image, interpolation="nearest")
            plain(axes, title if at == 0 else "")
            if column == 0:
                axes.set_ylabel(f"{scored.frame.dataset}, {scored.frame.number}", fontsize=9, color=INK)
        axes.text(0.98, 0.03, f"F {scored.full.f_score:.3f}", transform=axes.transAxes, ha="right", color=INK)
    save(figure, path)


def _heat(disparity: NDArray[np.uint16]) -> FloatArray:
    matched = matched_pixels(disparity)
    if not matched.any():
        return np.zeros((*disparity.shape, 3))
    low, high = np.quantile(disparity[matched], SHADES)
    image = matplotlib.colormaps[HEAT](np.clip((disparity - low) / max(high - low, 1.0), 0.0, 1.0))[..., :3]
    image[~matched] = 0.0
    return np.asarray(image)


def _masked(mask: Mask) -> FloatArray:
    return np.repeat(mask[..., None].astype(np.float64), 3, axis=2)


def _difference(truth: Mask, estimate: Mask) -> FloatArray:
    image = np.full((*truth.shape, 3), 0.93)
    image[truth & estimate] = HIT
    image[truth & ~estimate] = MISSED
    image[~truth & estimate] = TOO_MUCH
    return image
