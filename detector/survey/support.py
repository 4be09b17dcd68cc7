"""Which points lie below the road where a hole is, however shallow: each against the noise and its neighbours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detector.arrays import FloatArray
from detector.survey.grid import components_of, smooth
from detector.survey.road import Relief

# The road's own waves reach this many of their standard deviations.
WAVE_SD = 1.0
# Depth from which a point of a hole may lie, in standard deviations: a hole has no depth of its own at its rim.
RIM_SD = 1.6
MAX_LOG_RATIO = 8.0
# Weight of the neighbours' opinion, and their reach in cells.
NEIGHBOUR_WEIGHT = 5.0
NEIGHBOUR_CELLS = 0.8
SWEEPS = 6


def below_road(relief: Relief, inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Points (N,) that lie below the road and are connected to the cells (R, C) of a hole.

    A Markov random field by mean field: the log likelihood ratio of each point, as road (a normal distribution) or as
    hole (any depth), and the share of its neighbourhood that is taken for hole.
    """
    ratio = _log_ratio(relief)
    occupied = (relief.count > 0).astype(np.float64)
    probability = 1.0 / (1.0 + np.exp(-ratio))
    for _ in range(SWEEPS):
        share_map, _ = smooth(relief.grid.mean(relief.cells, probability, relief.count), occupied, NEIGHBOUR_CELLS)
        share = np.clip(relief.grid.sample(share_map, relief.xy_m), 1e-3, 1.0 - 1e-3)
        probability = 1.0 / (1.0 + np.exp(-ratio - NEIGHBOUR_WEIGHT * np.log(share / (1.0 - share))))
    below = probability > 0.5
    mass = relief.grid.mean(relief.cells, below.astype(np.float64), relief.count)
    components, count = components_of((mass > 0.0) | inside, diagonal=True)
    connected = np.zeros(count + 1, dtype=bool)
    connected[np.unique(components[inside])] = True
    connected[0] = False
    return np.asarray(below & connected[components.ravel()[relief.cells]])


def _log_ratio(relief: Relief) -> FloatArray:
    sd = np.hypot(relief.noise_m, relief.wave_m)
    depth = (relief.depth_m - WAVE_SD * relief.wave_m) / sd
    short = np.maximum(RIM_SD - depth, 0.0)
    ratio = 0.5 * (np.square(depth) * np.sign(depth) - np.square(short))
    return np.asarray(np.clip(ratio, -MAX_LOG_RATIO, MAX_LOG_RATIO))
