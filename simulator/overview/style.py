"""Colours, words and marks that the panels share."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from contract.geometry import Kind
from simulator.changes import APPEARED, GROWN, REMOVED

FloatArray = NDArray[np.float64]

PAPER, INK, QUIET = "#ffffff", "#1d2026", "#6a7280"
KIND_COLOURS = {Kind.POTHOLE: "#d00000", Kind.BUMP: "#e07a00", Kind.DEBRIS: "#0077b6"}
EGO_COLOURS = ("#00735c", "#7b2cbf", "#b5179e", "#3a5a00", "#005f99", "#8a4b08", "#444444", "#a3001f")
CHANGE_MARKS = {APPEARED: "o", GROWN: "^", REMOVED: "X"}

LABEL_GAP_PX = 22.0
"""Nearer to its neighbour a number is left out."""


def note(axes: Axes, text: str, at: FloatArray, offset_pt: tuple[float, float], colour: str, **style: Any) -> None:
    """A word beside a place (x, y)."""
    usual: dict[str, Any] = {"fontsize": 8, "ha": "center", "va": "center", "zorder": 5}
    usual["path_effects"] = [withStroke(linewidth=2.0, foreground=PAPER)]
    place = float(at[0]), float(at[1])
    axes.annotate(text, place, offset_pt, textcoords="offset points", color=colour, **(usual | style))


def headline(axes: Axes, text: str, **style: Any) -> None:
    """What a panel shows."""
    axes.set_title(text, loc="left", fontsize=9.5, **style)


def without_frame(axes: Axes) -> None:
    """Leave the picture alone: neither ticks nor a frame."""
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
