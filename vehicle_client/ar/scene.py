"""What to draw for the driver, in pixels: the hazards and the camera decide, the renderer only paints.

Rules (`docs/driver.md`): one card and at most three ground markers; a ground ellipse and no boxes; beyond 15 m a
beacon, since a 0.8 m hole is 5 arcmin tall at 26 m; the marker never hides the hole; what is about to be passed fades.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from contract.geometry import Kind
from vehicle_client.alerts import Alerts, Hazard, Stage
from vehicle_client.ar.camera import arcmin_px, is_inside, project
from vehicle_client.frames import Matrix, Vector
from vehicle_client.sensing.calibration import CameraCalibration

MAX_MARKERS = 3
"""Users prefer permanent but little content."""

BEACON_BEYOND_M = 15.0
"""Nearer than this the ellipse alone is large enough to be seen."""

BEACON_ARCMIN = 40.0
"""Twice the 20 arcmin that MIL-STD-411F asks for legible symbols."""

RING_ARCMIN = 5.0
"""Five times what the eye resolves; wider rings would take the overlay beyond 5 % of the picture."""

TEXT_ARCMIN = 48.0
"""Text height that is read at a contrast of 1.2:1 (Wan & Tsimhoni 2021)."""

MIN_TEXT_SHARE = 1 / 32
"""Least text height as a share of the image's: a picture seen on a desk covers fewer degrees than a windshield."""

ELLIPSE_MARGIN_M = 0.25
"""The ring runs outside the hole, so that it never hides it."""

MIN_RING_M = 0.5
"""A ring smaller than this (semi-axis) is a dot."""


@dataclass(frozen=True, slots=True)
class GroundMarker:
    """A ring on the road: `outline_px` (N, 2). `recognised` when the own LiDAR sees the obstacle."""

    outline_px: Matrix
    width_px: float
    opacity: float
    recognised: bool


@dataclass(frozen=True, slots=True)
class Beacon:
    """A pin that stands on the road over a far obstacle: foot and head in pixels, head's radius."""

    foot_px: Vector
    head_px: Vector
    radius_px: float
    recognised: bool


@dataclass(frozen=True, slots=True)
class Card:
    """The one card: a danger triangle with the sign of the kind, and two short lines."""

    kind: Kind
    group: bool
    title: str
    detail: str


@dataclass(frozen=True, slots=True)
class Scene:
    """Everything that is drawn over one camera image."""

    card: Card | None
    markers: tuple[GroundMarker, ...]
    beacons: tuple[Beacon, ...]
    points_px: Matrix
    """(N, 2) pixels of the points of recognised obstacles, drawn in the paper's red."""
    status: str
    text_px: float


def compose(alerts: Alerts, camera: CameraCalibration, own_points_vehicle_m: Matrix, *, status_note: str = "") -> Scene:
    """The scene for one frame; `own_points_vehicle_m` (N, 3) are the points of obstacles recognised in this sweep."""
    marked = [h for h in alerts.hazards if _is_marked(h)][:MAX_MARKERS]
    return Scene(
        card=_card(alerts.hazards),
        markers=tuple(m for h in marked if (m := _marker(h, camera)) is not None),
        beacons=tuple(b for h in marked if h.distance_m > BEACON_BEYOND_M and (b := _beacon(h, camera)) is not None),
        points_px=_inside_pixels(camera, own_points_vehicle_m),
        status=_status(alerts, status_note),
        text_px=max(arcmin_px(camera, TEXT_ARCMIN), MIN_TEXT_SHARE * camera.height_px),
    )


def _is_marked(hazard: Hazard) -> bool:
    return hazard.stage >= Stage.WARN or hazard.recognised


def _card(hazards: Sequence[Hazard]) -> Card | None:
    announced = [h for h in hazards if h.stage in (Stage.ADVISE, Stage.WARN)]
    if not announced:
        return None
    first = announced[0]
    group = sum(h.kind is first.kind for h in announced) > 1
    return Card(first.kind, group, first.title, f"{_rounded_m(first.distance_m)} m · {first.arrival_s:.0f} s")


def _rounded_m(distance_m: float) -> int:
    # Steps of 10 m, of 5 m when near: a figure that flickers is read again and again.
    step = 10 if distance_m > 50 else 5
    return max(step, step * round(distance_m / step))


def _marker(hazard: Hazard, camera: CameraCalibration) -> GroundMarker | None:
    pixels, _ = project(camera, _ellipse(hazard))
    if np.isnan(pixels).any() or not is_inside(camera, pixels).any():
        return None
    opacity = 0.55 if hazard.stage is Stage.MARK else 1.0
    return GroundMarker(pixels, arcmin_px(camera, RING_ARCMIN), opacity, hazard.recognised)


def _ellipse(hazard: Hazard) -> Matrix:
    angles = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    along = max(hazard.length_m / 2 + ELLIPSE_MARGIN_M, MIN_RING_M) * np.cos(angles)
    across = max(hazard.width_m / 2 + ELLIPSE_MARGIN_M, MIN_RING_M) * np.sin(angles)
    cos, sin = np.cos(hazard.yaw_rad), np.sin(hazard.yaw_rad)
    x = hazard.centre_vehicle_m[0] + along * cos - across * sin
    y = hazard.centre_vehicle_m[1] + along * sin + across * cos
    return np.column_stack([x, y, np.full_like(x, hazard.centre_vehicle_m[2])])


def _beacon(hazard: Hazard, camera: CameraCalibration) -> Beacon | None:
    foot, _ = project(camera, hazard.centre_vehicle_m[None])
    if np.isnan(foot).any() or not is_inside(camera, foot).all():
        return None
    size_px = arcmin_px(camera, BEACON_ARCMIN)
    head = foot[0] - np.array([0.0, 1.6 * size_px])
    return Beacon(foot[0], head, size_px / 2, hazard.recognised)


def _inside_pixels(camera: CameraCalibration, points_vehicle_m: Matrix) -> Matrix:
    if not len(points_vehicle_m):
        return np.empty((0, 2))
    pixels, _ = project(camera, points_vehicle_m)
    kept: Matrix = pixels[is_inside(camera, pixels)]
    return kept


def _status(alerts: Alerts, note: str) -> str:
    count = len(alerts.hazards)
    said = "Road clear" if count == 0 else f"{count} hazard{'s' if count > 1 else ''} ahead"
    return " · ".join(part for part in (said, note, "" if alerts.fresh else "map not fresh") if part)
