"""Stereo frames as clouds of points, and what the detector says of the points as masks of pixels.

A frame is a 16-bit map of *transformed* disparity (Fan et al., "Pothole Detection Based on Disparity Transformation and
Road Surface Modeling", IEEE TIP 2019): the road's own slope is taken out, so the map reads like a view from straight
above. The camera was a ZED: baseline 120 mm, focal length about 1400 pixels at full and 700 at half resolution (its
data sheet), hand-held about 1.2 m above the road, so that a pixel covers 1.2 m / 700. The files state no scale of
disparity; the nominal one below makes the potholes 4 to 12 cm deep. Every frame uses the same numbers; the detector's
thresholds follow the frame's own noise and waves.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_fill_holes, label, median_filter

from detector.types import FrameDetection
from evaluation.survey_detection import in_pothole

FloatArray = NDArray[np.float64]
MaskArray = NDArray[np.bool_]

PIXEL_M = 1.2 / 700.0
METRES_PER_UNIT = 2.2e-6
# A match at a quarter of the road's disparity would lie four times as far as the road.
LEAST_SHARE = 0.25
# Pixels without a match are hidden by the wall of a hole when so much of their surroundings is in it.
HIDDEN_SHARE = 0.25
# The dataset's authors leave these out of their own evaluation (its README).
LEFT_OUT = {("dataset2", number) for number in ("06", "07", "08", "13", "14", "15", "21", "22", "23", "37", "38", "39")}


class StereoError(ValueError):
    """A frame cannot be used; the message says why."""


@dataclass(frozen=True, slots=True)
class StereoFrame:
    """Transformed disparity (H, W), 0 where there is no match, and the labelled pothole pixels (H, W)."""

    dataset: str
    number: str
    disparity: NDArray[np.uint16]
    label: MaskArray

    @property
    def left_out(self) -> bool:
        """Whether the dataset's authors leave the frame out."""
        return (self.dataset, self.number) in LEFT_OUT


def frames_in(folder: Path) -> list[tuple[Path, Path]]:
    """Disparity and label files under `dataset*/` of a folder or of its `stereo`. Raises StereoError where none are."""
    found = sorted(folder.glob("dataset*/*_disparity.png")) or sorted(folder.glob("stereo/dataset*/*_disparity.png"))
    if not found:
        raise StereoError(f"{folder}: no dataset*/NN_disparity.png there nor in {folder / 'stereo'}")
    pairs = [(path, path.with_name(path.name.replace("_disparity", "_label"))) for path in found]
    for _, labels in pairs:
        if not labels.exists():
            raise StereoError(f"{labels} is missing: every disparity needs its label")
    return pairs


def read_frame(disparity_file: Path, label_file: Path) -> StereoFrame:
    """A frame from its two files. Raises StereoError."""
    import cv2

    disparity = cv2.imread(str(disparity_file), cv2.IMREAD_UNCHANGED)
    labels = cv2.imread(str(label_file), cv2.IMREAD_UNCHANGED)
    if disparity is None or disparity.dtype != np.uint16 or disparity.ndim != 2:
        raise StereoError(f"{disparity_file}: a 16-bit grey PNG is expected")
    if labels is None or labels.shape[:2] != disparity.shape:
        raise StereoError(f"{label_file}: a mask of the disparity's size is expected")
    mask = labels > 0 if labels.ndim == 2 else (labels > 0).any(axis=2)
    number = disparity_file.name.removesuffix("_disparity.png")
    return StereoFrame(disparity_file.parent.name, number, disparity.astype(np.uint16), np.asarray(mask))


def matched_pixels(disparity: NDArray[np.uint16]) -> MaskArray:
    """Pixels (H, W) with a match that can be road or hole."""
    matched = disparity > 0
    if matched.any():
        matched &= disparity >= LEAST_SHARE * float(np.median(disparity[matched]))
    return np.asarray(matched)


def cloud_of(disparity: NDArray[np.uint16], matched: MaskArray) -> FloatArray:
    """Points (N, 3) in metres of the matched pixels in row order: x right, y up the image, z up."""
    row, column = np.nonzero(matched)
    height = disparity[row, column].astype(np.float64) * METRES_PER_UNIT
    return np.stack([column * PIXEL_M, -row * PIXEL_M, height], axis=1)


def mask_of(detection: FrameDetection, matched: MaskArray) -> MaskArray:
    """Pixels (H, W) of recognised potholes.

    A matched pixel is what its point is. Pixels without a match belong to a hole when it encloses them, or when a
    quarter of what surrounds their patch does: the wall of the hole hides them.
    """
    mask = np.zeros(matched.shape, dtype=bool)
    mask[matched] = in_pothole(detection)
    numbers, count = label(~matched)
    patches: NDArray[np.int64] = np.asarray(numbers, dtype=np.int64)
    around, in_hole = np.zeros(count + 1), np.zeros(count + 1)
    for axis in (0, 1):
        for step in (1, -1):
            # What a roll brings round from the other border lies outside the picture.
            beside = np.roll(patches, step, axis)
            np.moveaxis(beside, axis, 0)[0 if step == 1 else -1] = 0
            touching = matched & (beside > 0)
            around += np.bincount(beside[touching], minlength=count + 1)
            in_hole += np.bincount(beside[touching & mask], minlength=count + 1)
    hidden = in_hole >= HIDDEN_SHARE * np.maximum(around, 1.0)
    hidden[0] = False
    mask = binary_fill_holes(mask | hidden[patches])
    # Pixels do not coincide with the detector's cells: single ones at the rim go with the majority about them.
    return np.asarray(median_filter(mask.astype(np.uint8), 3) > 0)
