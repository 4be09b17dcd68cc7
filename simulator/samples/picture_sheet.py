"""Samples on a road as a camera sees them, four rows of six, each with its kind and sizes."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from contract.geometry import Kind
from simulator.painting.sky import daylight
from simulator.samples.sample import Sample, SampleKind
from simulator.sensors.camera import CameraModel
from simulator.shapes.debris import Debris
from simulator.shapes.relief import Relief
from simulator.streets.road import straight_road
from simulator.streets.street import DRAWN_BEYOND_M, LANE_CENTRE_M, PlacedObstacle, Roadside, Street
from simulator.world import World

FloatArray = NDArray[np.float64]

COLUMNS, ROWS = 6, 4
SHEET_SAMPLES = COLUMNS * ROWS

PICTURE_PX = (400, 300)
SHARE_OF_PICTURE, WIDEST_RAD = 0.48, math.radians(65.0)
"""Part of a picture's width that an obstacle fills, and the field of view of a telephone's camera, its limit."""

NARROWEST_M = 1.4
"""Of road across a picture: nearer, the mesh's cells of 2 cm are seen."""

SPACING_M = 16.0
"""One sample does not show in another's picture, or only far off."""

EYE_HEIGHT_M = 1.5
"""Between a driver's eyes (1.2 m) and a pedestrian's (1.6 m)."""

LIGHT = daylight(math.radians(40.0), math.radians(65.0))
"""A low sun on the left, ahead: walls and edges throw shadows towards the camera."""

KINDS = {
    SampleKind.POTHOLE: Kind.POTHOLE,
    SampleKind.BUMP: Kind.BUMP,
    SampleKind.HUMP: Kind.BUMP,
    SampleKind.DEBRIS: Kind.DEBRIS,
}


TURNED_RAD = {
    SampleKind.POTHOLE: (-0.5, 0.5),
    SampleKind.BUMP: (-0.5, 0.5),
    SampleKind.HUMP: (0.0, 0.0),
    SampleKind.DEBRIS: (0.7, 1.3),
}
"""Holes follow the wheels' tracks, humps cross the road, and things are seen from their longer side."""


def draw_sheet(samples: Sequence[Sample]) -> bytes:
    """PNG of up to 24 samples, six in a row; the same samples give the same bytes. `ValueError` if none or more."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # heavy: only those who draw wait for it
    from matplotlib.figure import Figure

    pictures = photographs(samples)
    rows = math.ceil(len(pictures) / COLUMNS)
    columns = min(len(pictures), COLUMNS)
    figure = Figure(figsize=(columns * 4.1, rows * 3.6), dpi=100, facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, squeeze=False, gridspec_kw={"wspace": 0.025, "hspace": 0.18})
    figure.subplots_adjust(0.004, 0.60 / (3.6 * rows), 0.996, 0.996)
    for axis in axes.flat:
        axis.axis("off")
    for axis, sample, picture in zip(axes.flat, samples, pictures, strict=False):
        axis.imshow(picture[..., ::-1], interpolation="none")
        title, sizes = caption(sample)
        axis.text(0.01, -0.03, title, transform=axis.transAxes, va="top", fontsize=14, weight="bold")
        axis.text(0.01, -0.105, sizes, transform=axis.transAxes, va="top", fontsize=13, color="0.25")
    data = io.BytesIO()
    figure.savefig(data, format="png", metadata={"Software": None})
    return data.getvalue()


def photographs(samples: Sequence[Sample]) -> list[NDArray[np.uint8]]:
    """A picture (300, 400, 3) BGR of each sample on one road."""
    if not 0 < len(samples) <= SHEET_SAMPLES:
        raise ValueError(f"a sheet shows 1 to {SHEET_SAMPLES} samples, not {len(samples)}")
    placed = tuple(_placed(index, sample) for index, sample in enumerate(samples))
    length_m = (len(samples) + 1) * SPACING_M
    street = Street(
        samples[0].seed,
        placed,
        roads=(straight_road(length_m, DRAWN_BEYOND_M),),
        roadsides=(Roadside.WALL, Roadside.TREES),
    )
    world = World(street, daylight=LIGHT)
    return [world.render(_camera(obstacle), np.eye(4), supersample=2) for obstacle in placed]


def caption(sample: Sample) -> tuple[str, str]:
    """What it is, and its length x width x depth or height."""
    shape = sample.shape
    upright = "deep" if isinstance(shape, Relief) and shape.is_hole else "high"
    sizes = f"{shape.length_m:.2f} x {shape.width_m:.2f} m, {100 * shape.relief_m:.1f} cm {upright}"
    return sample.title, sizes


def _placed(index: int, sample: Sample) -> PlacedObstacle:
    """In the right lane; what is as wide as the road on its middle."""
    shape = sample.shape
    y = 0.0 if shape.width_m > 2 * abs(LANE_CENTRE_M) else LANE_CENTRE_M
    turned = float(np.random.default_rng([sample.seed, 7]).uniform(*TURNED_RAD[sample.kind]))
    return PlacedObstacle(index + 1, KINDS[sample.kind], (index + 1) * SPACING_M, y, turned, shape)


def _camera(placed: PlacedObstacle) -> CameraModel:
    """From eye height some metres off, turned up until the obstacle fills half of the picture."""
    shape = placed.shape
    size_m = max(shape.width_m, 0.8 * shape.length_m, 1.5 * shape.relief_m)
    distance_m = float(np.clip(1.2 * size_m + 1.6, 2.0, 6.0))
    eye = np.array([placed.x_m - distance_m, placed.y_m + 0.25 * distance_m, EYE_HEIGHT_M])
    middle = np.array([placed.x_m, placed.y_m, shape.relief_m / 2 if isinstance(shape, Debris) else 0.0])
    across_m = max(size_m / SHARE_OF_PICTURE, NARROWEST_M)
    field_rad = 2 * math.atan(across_m / 2 / float(np.linalg.norm(middle - eye)))
    return CameraModel(*PICTURE_PX, min(field_rad, WIDEST_RAD), _looking(eye, middle))


def _looking(eye_m: FloatArray, at_m: FloatArray) -> FloatArray:
    """`street_from_camera` (4, 4) of a level camera at one place that looks at another."""
    forward = (at_m - eye_m) / np.linalg.norm(at_m - eye_m)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    transform = np.eye(4)
    transform[:3, :3] = np.array([right, np.cross(forward, right), forward]).T
    transform[:3, 3] = eye_m
    return transform
