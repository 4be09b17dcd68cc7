"""Pictures of a data set and of one of its drives, from their files alone.

python docs/examples/dataset_pictures.py worlds SET PICTURE.jpg 0002 0004 ...
python docs/examples/dataset_pictures.py views RECORDING PICTURE.jpg
python docs/examples/dataset_pictures.py overview RECORDING PICTURE.jpg
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import cv2
import numpy as np

LIDAR, CAMERA, SEMANTIC = "sensor.lidar.ray_cast", "sensor.camera.rgb", "sensor.camera.semantic_segmentation"
COLUMNS, TILE = 3, (640, 320)
BACKGROUND = (20, 14, 11)

# CARLA's palette (red, green, blue) of the tags that these streets hold.
TAG_COLOURS = {
    1: (128, 64, 128),
    2: (244, 35, 232),
    3: (70, 70, 70),
    4: (102, 102, 156),
    6: (153, 153, 153),
    9: (107, 142, 35),
    10: (152, 251, 152),
    11: (70, 130, 180),
    12: (220, 20, 60),
    14: (0, 0, 142),
    21: (170, 120, 50),
    23: (45, 60, 150),
    24: (157, 234, 50),
}
# Values of simulator.scenery.Surface, in the colours of the tags.
SURFACE_COLOURS = {1: (120, 124, 134), 2: (210, 110, 200), 3: (190, 90, 180), 8: (70, 90, 235), 9: (70, 90, 235)}
OTHER_COLOUR, MOVER_COLOUR = (95, 110, 105), (70, 210, 255)
OBSTACLE_COLOURS = {"pothole": (255, 60, 50), "bump": (255, 160, 30), "debris": (255, 235, 60)}

# The eye behind and above the LiDAR, looking down: metres, radians, pixels.
EYE_BEHIND_M, EYE_UP_M, LOOK_DOWN_RAD, FOCAL_PX = 7.0, 2.6, math.radians(16), 620.0


def worlds(dataset: Path, names: list[str]) -> np.ndarray:
    """The first picture of each drive, three in a row."""
    pictures = [cv2.imread(str(min((dataset / name / "ego0" / CAMERA).glob("*.png")))) for name in names]
    tiles = [cv2.resize(picture, TILE, interpolation=cv2.INTER_AREA) for picture in pictures]
    rows = [np.hstack(tiles[start : start + COLUMNS]) for start in range(0, len(tiles), COLUMNS)]
    return np.vstack(rows)


def views(run: Path) -> np.ndarray:
    """The frame with the most points on a pothole ahead: picture and tags above, the LiDAR's labels below."""
    ego, truth = run / "ego0", json.loads((run / "obstacles.json").read_text())
    holes = [row["obstacle_id"] for row in truth if row["kind"] == "pothole"]
    frames = sorted(path.stem for path in (ego / LIDAR / "labels").glob("*.npz"))
    frame = max(frames, key=lambda stem: _ahead(ego, stem, holes))
    picture = cv2.imread(str(ego / CAMERA / f"{frame}.png"))
    tags = cv2.imread(str(ego / SEMANTIC / f"{frame}.png"))[..., 2]
    palette = np.zeros((256, 3), np.uint8)
    for tag, colour in TAG_COLOURS.items():
        palette[tag] = colour[::-1]
    above = np.hstack([picture, palette[tags]])
    both = np.vstack([above, _labelled(run, ego, frame, above.shape[1])])
    return cv2.resize(both, None, fx=0.75, fy=0.75, interpolation=cv2.INTER_AREA)


def overview(run: Path) -> np.ndarray:
    """The recording's own picture, smaller."""
    return cv2.resize(cv2.imread(str(run / "overview.png")), None, fx=0.8, fy=0.8, interpolation=cv2.INTER_AREA)


def _sweep(ego: Path, frame: str) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Points (N, 3) with y to the left, and what they lie on."""
    points = np.loadtxt(ego / LIDAR / f"{frame}.ply", skiprows=8)[:, :3] * (1, -1, 1)
    return points, dict(np.load(ego / LIDAR / "labels" / f"{frame}.npz"))


def _ahead(ego: Path, frame: str, numbers: list[int]) -> int:
    """Points on some obstacles where the camera sees them."""
    points, labels = _sweep(ego, frame)
    return int((np.isin(labels["obstacle_id"], numbers) & (points[:, 0] > 6) & (points[:, 0] < 16)).sum())


def _labelled(run: Path, ego: Path, frame: str, width: int) -> np.ndarray:
    points, labels = _sweep(ego, frame)
    kinds = {row["obstacle_id"]: row["kind"] for row in json.loads((run / "obstacles.json").read_text())}
    colours = np.full((len(points), 3), OTHER_COLOUR, np.uint8)
    for surface, colour in SURFACE_COLOURS.items():
        colours[labels["surface"] == surface] = colour
    colours[labels["mover_id"] > 0] = MOVER_COLOUR
    for number, kind in kinds.items():
        colours[labels["obstacle_id"] == number] = OBSTACLE_COLOURS[kind]
    height = round(width * 0.36)
    x, z = points[:, 0] + EYE_BEHIND_M, points[:, 2] - EYE_UP_M
    depth = math.cos(LOOK_DOWN_RAD) * x - math.sin(LOOK_DOWN_RAD) * z
    down = -math.sin(LOOK_DOWN_RAD) * x - math.cos(LOOK_DOWN_RAD) * z
    canvas = np.full((height, width, 3), BACKGROUND, np.uint8)
    in_front = depth > 1
    u = np.full(len(points), -1.0)
    v = u.copy()
    u[in_front] = width / 2 - FOCAL_PX * 2 * points[in_front, 1] / depth[in_front]
    v[in_front] = height * 0.34 + FOCAL_PX * 2 * down[in_front] / depth[in_front]
    # Far points first, and those on obstacles over all others.
    for index in np.lexsort([-depth, labels["obstacle_id"] > 0]):
        radius = 3 if labels["obstacle_id"][index] else 1 if depth[index] > 22 else 2
        cv2.circle(canvas, (round(u[index]), round(v[index])), radius, colours[index, ::-1].tolist(), -1, cv2.LINE_AA)
    return canvas


def main(what: str, source: str, target: str, *names: str) -> None:
    """Make one of the pictures."""
    match what:
        case "worlds":
            made = worlds(Path(source), list(names))
        case "views":
            made = views(Path(source))
        case _:
            made = overview(Path(source))
    cv2.imwrite(target, made, (cv2.IMWRITE_JPEG_QUALITY, 82))


if __name__ == "__main__":
    main(*sys.argv[1:])
