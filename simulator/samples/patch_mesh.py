"""A piece of road around a relief as one closed solid: what is set into a map of CARLA, or printed.

The top carries the relief and ends in a border at exactly z = 0; a skirt and a bottom close it. CARLA's editor counts
in centimetres and its y points right: meshes are in metres with y left, so import them with a scale of 100 and leave
the mirroring to the importer.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from simulator.samples.labelled_mesh import LabelledMesh
from simulator.shapes.relief import Material, Relief

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

SLAB_BELOW_M = 0.10
"""Of solid road under the deepest place."""

LARGEST_SIDE_M = 40.0
"""A road's width and more."""

WIDENING = 1.25
"""Cells grow by this factor from the relief's grid out to the border: flat road needs no detail."""


MARGIN_M = 0.3
"""Of undisturbed road around a relief, where no size is asked for."""


def patch_half_size(relief: Relief, side_m: float | None = None) -> tuple[float, float]:
    """Half length and half width in metres of a patch: a square of `side_m`, else 0.3 m beyond what the relief bends.

    `ValueError` for a square that does not hold the relief, or of more than 40 m.
    """
    bent_x_m, bent_y_m = _bent_half_size(relief)
    if side_m is None:
        return bent_x_m + MARGIN_M, bent_y_m + MARGIN_M
    least_m = 2 * max(bent_x_m, bent_y_m)
    if not least_m <= side_m <= LARGEST_SIDE_M:
        raise ValueError(
            f"a patch around this one has sides of {least_m:.2f} to {LARGEST_SIDE_M:.0f} m, not {side_m} m"
        )
    return side_m / 2, side_m / 2


def patch_mesh(relief: Relief, side_m: float | None = None, max_vertices: int = 60_000) -> LabelledMesh:
    """Closed solid of the road around a relief, with at most `max_vertices`; every edge belongs to two triangles.

    Its size is that of `patch_half_size`. The cells are those of the relief's grid, or larger where the number of
    vertices asks for it.
    """
    half = patch_half_size(relief, side_m)
    xs, ys = _axes_within(relief, half, max_vertices)
    x, y = np.meshgrid(xs, ys)
    z = relief.height_at(x, y)
    z[0], z[-1], z[:, 0], z[:, -1] = 0.0, 0.0, 0.0, 0.0
    top = np.stack([x, y, z], axis=-1)
    bottom_z = float(z.min()) - SLAB_BELOW_M
    ring = _border(len(ys), len(xs))
    lower = top.reshape(-1, 3)[ring]
    lower[:, 2] = bottom_z
    vertices = np.concatenate([top.reshape(-1, 3), lower, [[0.0, 0.0, bottom_z]]])
    on_top = len(vertices) - len(lower) - 1
    label, material = np.zeros((2, len(vertices)), dtype=np.uint8)
    label[:on_top] = relief.covers(x, y).ravel()
    material[:on_top] = relief.material_at(x, y).ravel()
    material[on_top:] = Material.ASPHALT
    uv = vertices[:, :2] / (2 * np.array(half)) + 0.5
    return LabelledMesh(vertices, _closed(len(ys), len(xs), ring), label, material, uv)


def _bent_half_size(relief: Relief) -> tuple[float, float]:
    """Half length and half width of what lies within one step of the relief's grid."""
    rows, columns = relief.heights_m.shape
    return (columns + 1) / 2 * relief.step_m, (rows + 1) / 2 * relief.step_m


def _axes_within(relief: Relief, half: tuple[float, float], max_vertices: int) -> tuple[FloatArray, FloatArray]:
    """Positions of the columns and rows: as fine as the relief's grid, coarser until the vertices are few enough."""
    step_m = relief.step_m
    bent_x_m, bent_y_m = _bent_half_size(relief)
    while True:
        xs, ys = _axis(bent_x_m, half[0], step_m), _axis(bent_y_m, half[1], step_m)
        if len(xs) * len(ys) + 2 * (len(xs) + len(ys)) <= max_vertices:
            return xs, ys
        if len(xs) * len(ys) <= 25:
            raise ValueError(f"a patch takes more than {max_vertices} vertices")
        step_m *= 1.05


def _axis(fine_half_m: float, half_m: float, step_m: float) -> FloatArray:
    """Positions from -half to half: even steps over the fine part, widening ones out to the border."""
    inner = np.linspace(-fine_half_m, fine_half_m, max(3, 1 + math.ceil(2 * fine_half_m / step_m)))
    outer, reach, step = [], fine_half_m, step_m
    while half_m - reach > 1e-9:
        step *= WIDENING
        # No sliver is left at the border.
        reach = half_m if half_m - reach < 1.5 * step else reach + step
        outer.append(reach)
    return np.concatenate([-np.array(outer[::-1]), inner, outer])


def _border(rows: int, columns: int) -> IndexArray:
    """Vertices of the top's border, counter-clockwise from above."""
    index = np.arange(rows * columns).reshape(rows, columns)
    return np.concatenate([index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]])


def _closed(rows: int, columns: int, ring: IndexArray) -> IndexArray:
    """Triangles of the top, the skirt below its border, and the bottom as a fan about the last vertex."""
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (corner.ravel() for corner in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
    lower = rows * columns + np.arange(len(ring))
    next_ring, next_lower = np.roll(ring, -1), np.roll(lower, -1)
    middle = np.full(len(ring), rows * columns + len(ring))
    faces = [(a, b, c), (a, c, d), (ring, lower, next_lower), (ring, next_lower, next_ring)]
    faces.append((next_lower, lower, middle))
    return np.concatenate([np.stack(corners, axis=1) for corners in faces])
