"""The paper's figure of a scanned pothole at four densities: truth, heat map, the paper's estimate and ours."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from detector.pipeline import Method
from evaluation.composed_scan import DENSITIES_PERCENT, FLAT, VOXEL_MM, Scene, compose, degrade
from evaluation.figure_style import HEAT, INK, SOFT, Colours, from_above, new_figure, plain, save
from evaluation.survey_detection import below_road, detect_survey

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]

METHODS: tuple[Method, Method] = ("saliency", "surface")
ROAD_COLOUR, HOLE_COLOUR = "#2f6bff", "#f0241a"
# Of the hole's size, left around it.
MARGIN = 0.25
# Side of a panel: at full density points are drawn as large as they lie apart.
PANEL_PT = 205.0
METRES_PER_MM = 1e-3


def draw_scan(
    path: Path,
    mould_mm: FloatArray,
    source: str,
    noise_mm: float,
    seed: int,
    densities_percent: tuple[int, ...] = DENSITIES_PERCENT,
) -> None:
    """A row for each density of one scan (N, 3), set into a flat road, with noise on every point."""
    rng = np.random.default_rng(seed)
    whole = compose(mould_mm, FLAT, rng)
    subtitle = (
        f"{source}, noise {noise_mm:g} mm, seed {seed}; red: pothole, blue: road; heat map from dark (0) to red (1); "
        f"{_side_mm(whole):.0f} mm wide; RP, RR: share of pothole and road points called so"
    )
    height = 1.0 + 3.15 * len(densities_percent)
    figure = new_figure(13.0, height, "A scanned pothole, thinner and thinner", subtitle)
    grid = figure.add_gridspec(
        len(densities_percent),
        4,
        left=0.05,
        right=0.99,
        top=1.0 - 1.0 / height,
        bottom=0.4 / height,
        wspace=0.04,
        hspace=0.16,
    )
    for row, density in enumerate(densities_percent):
        scene = degrade(whole, density, noise_mm, rng)
        axes = [figure.add_subplot(grid[row, column]) for column in range(4)]
        _draw_row(axes, scene, VOXEL_MM / math.sqrt(math.sqrt(density / 100.0)), first=row == 0)
        axes[0].set_ylabel(f"{density} %\n{len(scene.truth):,} points", fontsize=10, color=INK)
    save(figure, path)


def _draw_row(axes: list[Axes], scene: Scene, dot_mm: float, first: bool) -> None:
    theirs, ours = (detect_survey(scene.points_mm * METRES_PER_MM, method) for method in METHODS)
    names = ("truth", "heat map (saliency)", "estimate, method saliency", "estimate, method surface")
    colours: tuple[Colours, ...] = (
        _two_colours(scene.truth),
        theirs.saliency,
        _two_colours(below_road(theirs)),
        _two_colours(below_road(ours)),
    )
    hole = scene.points_mm[scene.truth, :2]
    reach = 0.5 * _side_mm(scene)
    middle = 0.5 * (hole.min(axis=0) + hole.max(axis=0))
    for one, name, colour in zip(axes, names, colours, strict=True):
        from_above(one, scene.points_mm, colour, (dot_mm * PANEL_PT / (2.0 * reach)) ** 2)
        one.collections[0].set_cmap(HEAT)
        one.set_xlim(middle[0] - reach, middle[0] + reach)
        one.set_ylim(middle[1] - reach, middle[1] + reach)
        plain(one, name if first else "")
    for one, detection in zip(axes[2:], (theirs, ours), strict=True):
        called = below_road(detection)
        rp, rr = 100 * called[scene.truth].mean(), 100 * (~called[~scene.truth]).mean()
        one.set_xlabel(f"RP {rp:.2f} %   RR {rr:.2f} %", fontsize=9, color=SOFT)


def _side_mm(scene: Scene) -> float:
    """Side of what a panel shows."""
    return (1.0 + 2.0 * MARGIN) * float(np.ptp(scene.points_mm[scene.truth, :2], axis=0).max())


def _two_colours(hole: Mask) -> list[str]:
    return list(np.where(hole, HOLE_COLOUR, ROAD_COLOUR))
