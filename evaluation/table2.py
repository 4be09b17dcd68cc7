"""The paper's Table II anew: pothole pixels of stereo frames, and which potholes are found."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, label

from evaluation.stereo import MaskArray, StereoFrame, cloud_of, mask_of, matched_pixels, read_frame
from evaluation.survey_detection import detect_survey

# A labelled hole counts from this many pixels, and is found when half of it is covered.
LEAST_LABEL_PIXELS = 120
FOUND_SHARE = 0.5
# A predicted component is wrong when less of it is labelled.
WRONG_SHARE = 0.1
# Labels that three dilations join are one pothole.
LABEL_DILATIONS = 3
# The paper's recall, precision and accuracy hold together for this share of pothole pixels only:
# (1 - A) / ((1 - R) + R (1 - P) / P).
PAPER_POTHOLE_SHARE = (1 - 0.992) / ((1 - 0.899) + 0.899 * (1 - 0.994) / 0.994)


@dataclass(frozen=True, slots=True)
class Printed:
    """A line of the paper's Table II: F of each dataset, total recall, precision, accuracy, F, and potholes correct,
    incorrect, missed."""

    name: str
    dataset_f: tuple[float, float, float]
    total: tuple[float, float, float, float]
    potholes: tuple[int, int, int]


PRINTED = (
    Printed("paper, as printed", (0.918, 0.951, 0.969), (0.899, 0.994, 0.992, 0.945), (67, 0, 0)),
    Printed("Fan 2020, as printed there", (0.811, 0.915, 0.823), (0.890, 0.898, 0.996, 0.894), (78, 1, 0)),
)


@dataclass(frozen=True, slots=True)
class Pixels:
    """Numbers of pixels: pothole found, pothole missed, road called pothole, road."""

    true_positive: int
    false_negative: int
    false_positive: int
    true_negative: int

    def __add__(self, other: Pixels) -> Pixels:
        return Pixels(
            self.true_positive + other.true_positive,
            self.false_negative + other.false_negative,
            self.false_positive + other.false_positive,
            self.true_negative + other.true_negative,
        )

    @property
    def recall(self) -> float:
        """Share of pothole pixels that is found."""
        return self.true_positive / max(self.true_positive + self.false_negative, 1)

    @property
    def precision(self) -> float:
        """Share of what is called pothole that is."""
        return self.true_positive / max(self.true_positive + self.false_positive, 1)

    @property
    def accuracy(self) -> float:
        """Share of pixels that is right."""
        right = self.true_positive + self.true_negative
        return right / max(right + self.false_negative + self.false_positive, 1)

    @property
    def f_score(self) -> float:
        """Harmonic mean of recall and precision."""
        wrong = self.false_negative + self.false_positive
        return 2 * self.true_positive / max(2 * self.true_positive + wrong, 1)


@dataclass(frozen=True, slots=True)
class Potholes:
    """Labelled potholes found (correct) and not (missed), and predictions on none (incorrect)."""

    correct: int
    incorrect: int
    missed: int

    def __add__(self, other: Potholes) -> Potholes:
        return Potholes(self.correct + other.correct, self.incorrect + other.incorrect, self.missed + other.missed)


@dataclass(frozen=True, slots=True)
class ScoredFrame:
    """One frame with its predicted mask (H, W) and what is right in it, on the whole frame and on the crop."""

    frame: StereoFrame
    mask: MaskArray
    full: Pixels
    crop: Pixels
    potholes: Potholes


@dataclass(frozen=True, slots=True)
class Summary:
    """The sums over some frames."""

    name: str
    frames: int
    full: Pixels
    crop: Pixels
    potholes: Potholes

    def record(self) -> dict[str, object]:
        """As JSON."""
        rates = {
            region: {name: getattr(pixels, name) for name in ("recall", "precision", "accuracy", "f_score")}
            for region, pixels in (("full", self.full), ("crop", self.crop))
        }
        counts = {name: getattr(self.potholes, name) for name in ("correct", "incorrect", "missed")}
        return {"name": self.name, "frames": self.frames, **rates, **counts}


def score_frames(files: Iterable[tuple[Path, Path]]) -> Iterator[ScoredFrame]:
    """Read, detect and score frame by frame. Raises StereoError for a file that is no frame."""
    for disparity_file, label_file in files:
        frame = read_frame(disparity_file, label_file)
        matched = matched_pixels(frame.disparity)
        yield score(frame, mask_of(detect_survey(cloud_of(frame.disparity, matched)), matched))


def score(frame: StereoFrame, mask: MaskArray) -> ScoredFrame:
    """A frame's score for a predicted mask (H, W)."""
    rows, columns = paper_crop(frame.label)
    return ScoredFrame(
        frame,
        mask,
        pixels_of(frame.label, mask),
        pixels_of(frame.label[rows, columns], mask[rows, columns]),
        potholes_of(frame.label, mask),
    )


def pixels_of(truth: MaskArray, mask: MaskArray) -> Pixels:
    """Counts of a mask against the labels."""
    both = int((truth & mask).sum())
    missed, added = int(truth.sum()) - both, int(mask.sum()) - both
    return Pixels(both, missed, added, truth.size - both - missed - added)


def potholes_of(truth: MaskArray, mask: MaskArray) -> Potholes:
    """Labelled potholes found and missed, predicted components on none."""
    correct = missed = 0
    groups, count = label(binary_dilation(truth, iterations=LABEL_DILATIONS))
    for number in range(1, count + 1):
        pothole = truth & (groups == number)
        if pothole.sum() >= LEAST_LABEL_PIXELS:
            found = (pothole & mask).sum() >= FOUND_SHARE * pothole.sum()
            correct, missed = correct + int(found), missed + int(not found)
    predicted, count = label(mask)
    total = np.bincount(predicted.ravel(), minlength=count + 1)[1:]
    labelled = np.bincount(predicted[truth], minlength=count + 1)[1:]
    return Potholes(correct, int((labelled < WRONG_SHARE * total).sum()), missed)


def paper_crop(truth: MaskArray) -> tuple[slice, slice]:
    """The window around the labels, grown evenly, in which they fill the paper's share; the frame where they never
    fall to it, or there are none."""
    rows, columns = np.nonzero(truth)
    height, width = truth.shape
    if rows.size == 0:
        return slice(0, height), slice(0, width)
    for margin in range(max(height, width)):
        top, left = max(int(rows.min()) - margin, 0), max(int(columns.min()) - margin, 0)
        bottom, right = min(int(rows.max()) + margin + 1, height), min(int(columns.max()) + margin + 1, width)
        if rows.size <= PAPER_POTHOLE_SHARE * (bottom - top) * (right - left):
            break
    return slice(top, bottom), slice(left, right)


def summarise(name: str, scored: Iterable[ScoredFrame]) -> Summary:
    """Sums over frames."""
    frames = list(scored)
    nothing, none = Pixels(0, 0, 0, 0), Potholes(0, 0, 0)
    return Summary(
        name,
        len(frames),
        sum((f.full for f in frames), nothing),
        sum((f.crop for f in frames), nothing),
        sum((f.potholes for f in frames), none),
    )


def summaries(scored: list[ScoredFrame]) -> list[Summary]:
    """Each dataset, all, and all without the frames that the dataset's authors leave out."""
    datasets = dict.fromkeys(s.frame.dataset for s in scored)
    kept = [s for s in scored if not s.frame.left_out]
    return [
        *(summarise(name, (s for s in scored if s.frame.dataset == name)) for name in datasets),
        summarise("total", scored),
        summarise("total without frames left out", kept),
    ]


def overlay(scored: ScoredFrame) -> NDArray[np.uint8]:
    """Picture (H, W, 3), BGR: disparity, the labels' outline in white, the mask's in red."""
    import cv2

    disparity = scored.frame.disparity.astype(np.float64)
    low, high = np.percentile(disparity[disparity > 0], (1.0, 99.0)) if (disparity > 0).any() else (0.0, 1.0)
    shade = np.clip((disparity - low) / max(high - low, 1.0), 0.0, 1.0) * 255.0
    picture = cv2.applyColorMap(shade.astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    picture[disparity == 0] = 0
    for mask, colour in ((scored.frame.label, (255, 255, 255)), (scored.mask, (0, 0, 255))):
        contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(picture, contours, -1, colour, 2)
    return np.asarray(picture, dtype=np.uint8)
