"""What is laid out on a carriageway: painted lines, and the widths, slopes and lanes that a map gives along a road."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

LINE_WIDTH_M = 0.12
DASH_M, DASH_PERIOD_M = 3.0, 7.5
"""A dash is painted about every multiple of the period, from the road's own zero."""


@dataclass(frozen=True, slots=True, eq=False)
class PaintedLine:
    """A line along a road from one distance to another; `offset_m` (K, 2) are (s, t) pairs of its middle.

    `cover` is the share of its paint that is left; `colour` is white or yellow.
    """

    offset_m: FloatArray
    from_m: float
    to_m: float
    width_m: float = LINE_WIDTH_M
    dashed: bool = False
    cover: float = 1.0
    colour: str = "white"


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """A carriageway that changes along its road, given at distances `s_m` (K,).

    `half_width_m` (K,); `slope` (K,) is the rise to the left across the road; `lanes_m` (L, K) are the middles of the
    lanes that traffic drives in, as offsets to the left; `parking` says whether there is a parking lane along the left
    and along the right edge.
    """

    s_m: FloatArray
    half_width_m: FloatArray
    slope: FloatArray
    lanes_m: FloatArray
    lines: tuple[PaintedLine, ...]
    parking: tuple[bool, bool] = (False, False)
