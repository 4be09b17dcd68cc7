"""The paper's figure of one LiDAR frame: its saliency map, and the five classes that the detector makes of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray

from detector.pipeline import detect
from detector.types import DetectorInput
from evaluation.figure_style import (
    HEAT,
    INK,
    Colours,
    class_colours,
    class_legend,
    draw_boxes,
    from_above,
    from_behind,
    new_figure,
    plain,
    save,
)
from simulator.mesh import pose
from simulator.sensors.lidar_presets import LIDAR_PRESETS
from simulator.streets.street import LANE_CENTRE_M, first_light_street
from simulator.world import World

FloatArray = NDArray[np.float64]

AHEAD_M, BEHIND_M, BESIDE_M = 26.0, 6.0, 9.0
# A few corners and artefacts are far more salient than all else: the colours end at this share of the points.
BRIGHTEST = 0.995
STREET_SEED = 3
BEFORE_M = 9.0


@dataclass(frozen=True, slots=True)
class Frame:
    """Points (N, 3) float32 of one turn in the `sensor` frame, the sensor's height, and where they come from."""

    points_m: NDArray[np.float32]
    sensor_height_m: float
    source: str


@dataclass(frozen=True, slots=True)
class _Standing:
    """A sensor that waits in its lane."""

    x_m: float
    height_m: float

    def poses(self, time_s: FloatArray) -> FloatArray:
        return np.tile(pose(self.x_m, LANE_CENTRE_M, self.height_m), (len(time_s), 1, 1))


def simulated_frame(preset: str = "hdl64") -> Frame:
    """A turn in the demo's street, 9 m before its first pothole."""
    street, lidar = first_light_street(seed=STREET_SEED), LIDAR_PRESETS[preset]()
    motion = _Standing(street.obstacles[0].x_m - BEFORE_M, lidar.height_m)
    turn = World(street).sweep(lidar, motion, 0.0, np.random.default_rng(1))
    return Frame(turn.points_m.astype(np.float32), lidar.height_m, f"simulated street, sensor {preset}")


def kitti_frame(path: Path) -> Frame:
    """A frame of KITTI (.bin), whose sensor is 1.73 m above the road."""
    points = np.fromfile(path, np.float32).reshape(-1, 4)[:, :3]
    return Frame(np.ascontiguousarray(points), 1.73, f"KITTI, {path.stem} (Geiger et al., 2013)")


def draw_lidar(path: Path, frame: Frame) -> None:
    """Saliency map to the left, classes to the right; from behind the sensor above, from above below."""
    given = DetectorInput(frame.points_m, frame.sensor_height_m)
    classes, heat = detect(given), detect(given, "saliency").saliency.astype(np.float64)
    brightest = float(np.quantile(heat, BRIGHTEST)) or 1.0
    shades = matplotlib.colormaps[HEAT](np.clip(heat / brightest, 0.0, 1.0))
    points = frame.points_m.astype(np.float64)
    subtitle = (
        f"{frame.source}: {len(points):,} points; boxes: what is reported, {len(classes.obstacles)} in all; saliency "
        f"from dark to red. Below: {AHEAD_M + BEHIND_M:.0f} x {2 * BESIDE_M:.0f} m from above, ahead to the right"
    )
    figure = new_figure(14.0, 9.6, "Saliency map and segmentation of one sweep", subtitle)
    panels: tuple[tuple[str, Colours], ...] = (
        ("saliency map (method saliency)", shades),
        ("classes (method surface)", class_colours(classes.labels)),
    )
    for column, (title, colours) in enumerate(panels):
        forward = figure.add_axes((0.02 + 0.49 * column, 0.52, 0.47, 0.38))
        from_behind(forward, points, colours)
        plain(forward, title)
        above = figure.add_axes((0.02 + 0.49 * column, 0.07, 0.47, 0.43))
        # Ahead is to the right, so that the road fills the panel.
        inside = (points[:, 0] > -BEHIND_M) & (points[:, 0] < AHEAD_M) & (np.abs(points[:, 1]) < BESIDE_M)
        from_above(above, points[inside, :2], np.asarray(colours)[inside], 1.2)
        draw_boxes(above, classes.obstacles)
        above.plot([-2.2, 2.0, 2.0, -2.2, -2.2], [-0.9, -0.9, 0.9, 0.9, -0.9], color=INK, lw=1.0)
        above.set_xlim(-BEHIND_M, AHEAD_M)
        above.set_ylim(-BESIDE_M, BESIDE_M)
        plain(above)
    class_legend(figure, 0.005)
    save(figure, path)
