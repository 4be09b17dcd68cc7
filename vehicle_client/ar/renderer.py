"""Paints a scene over a camera image with Skia. Decides nothing."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import skia
from numpy.typing import NDArray

from contract.geometry import Kind
from vehicle_client.ar.scene import Beacon, Card, GroundMarker, Scene
from vehicle_client.frames import Matrix

Image = NDArray[np.uint8]

AMBER = 0xFFFFB000
"""Marker of what the server told; light enough for 3:1 on asphalt, and it has a dark halo for light backgrounds."""
RED = 0xFFFF3B30
"""Marker of what the own LiDAR recognised: the paper's red."""
HALO = 0xC0101418
PLATE = 0xE0161B22
INK = 0xFFF5F7FA
MUTED_INK = 0xFFC9D1D9
SIGN_RED = 0xFFD52B1E
SIGN_WHITE = 0xFFFDFDFD


def draw(scene: Scene, image: Image) -> Image:
    """The image (H, W, 3) uint8 BGR with the scene painted over it; the input is left as it is."""
    canvas_image = cv2.cvtColor(image, cv2.COLOR_BGR2BGRA)
    surface = skia.Surface(canvas_image, colorType=skia.ColorType.kBGRA_8888_ColorType)
    with surface as canvas:
        for marker in scene.markers:
            _draw_marker(canvas, marker)
        _draw_points(canvas, scene.points_px, image.shape[1])
        for beacon in scene.beacons:
            _draw_beacon(canvas, beacon)
        if scene.card is not None:
            _draw_card(canvas, scene.card, image.shape[1], scene.text_px)
        _draw_status(canvas, scene.status, image.shape[0], scene.text_px * 0.7)
    return np.asarray(cv2.cvtColor(canvas_image, cv2.COLOR_BGRA2BGR), dtype=np.uint8)


def _paint(colour: int, **style: Any) -> Any:
    return skia.Paint(AntiAlias=True, Color=colour, **style)


def _stroke(colour: int, width_px: float) -> Any:
    return _paint(colour, Style=skia.Paint.kStroke_Style, StrokeWidth=width_px, StrokeJoin=skia.Paint.kRound_Join)


def _with_opacity(colour: int, opacity: float) -> int:
    return (round((colour >> 24) * opacity) << 24) | (colour & 0xFFFFFF)


def _polygon(points_px: Matrix | Sequence[tuple[float, float]]) -> Any:
    path = skia.Path()
    path.addPoly([skia.Point(float(u), float(v)) for u, v in points_px], True)
    return path


def _draw_marker(canvas: Any, marker: GroundMarker) -> None:
    path = _polygon(marker.outline_px)
    colour = RED if marker.recognised else AMBER
    canvas.drawPath(path, _stroke(_with_opacity(HALO, marker.opacity), 2.2 * marker.width_px))
    canvas.drawPath(path, _stroke(_with_opacity(colour, marker.opacity), marker.width_px))


def _draw_points(canvas: Any, points_px: Matrix, width_px: int) -> None:
    radius = max(1.2, width_px / 640)
    paint = _paint(_with_opacity(RED, 0.85))
    for u, v in points_px:
        canvas.drawCircle(float(u), float(v), radius, paint)


def _draw_beacon(canvas: Any, beacon: Beacon) -> None:
    colour = RED if beacon.recognised else AMBER
    (u, v), (hu, hv), radius = beacon.foot_px, beacon.head_px, beacon.radius_px
    stem = _polygon([(u, v), (hu - 0.62 * radius, hv + 0.78 * radius), (hu + 0.62 * radius, hv + 0.78 * radius)])
    for path_paint, grow in ((_paint(HALO), 0.22 * radius), (_paint(colour), 0.0)):
        canvas.drawPath(stem, path_paint if not grow else _halo_fill(grow))
        canvas.drawCircle(float(hu), float(hv), radius + grow, path_paint)
    font = skia.Font(_typeface(), radius * 1.55)
    _text_centred(canvas, "!", float(hu), float(hv) + 0.56 * radius, font, 0xFF1A1200)


def _halo_fill(width_px: float) -> Any:
    return _paint(HALO, Style=skia.Paint.kStrokeAndFill_Style, StrokeWidth=2 * width_px)


def _draw_card(canvas: Any, card: Card, width_px: int, text_px: float) -> None:
    title, detail = skia.Font(_typeface(), text_px), skia.Font(_typeface(), text_px * 0.86)
    sign_px = 2.65 * text_px
    inner = max(title.measureText(card.title), detail.measureText(card.detail))
    plate_w, plate_h = sign_px + inner + 1.9 * text_px, sign_px + 0.8 * text_px
    left, top = (width_px - plate_w) / 2, 0.6 * text_px
    plate = skia.Rect.MakeXYWH(left, top, plate_w, plate_h)
    canvas.drawRoundRect(plate, 0.5 * text_px, 0.5 * text_px, _paint(PLATE))
    _draw_sign(canvas, card, left + 0.5 * text_px, top + 0.4 * text_px, sign_px)
    text_left = left + sign_px + 1.0 * text_px
    canvas.drawString(card.title, text_left, top + 1.5 * text_px, title, _paint(INK))
    canvas.drawString(card.detail, text_left, top + 2.75 * text_px, detail, _paint(MUTED_INK))


def _draw_sign(canvas: Any, card: Card, left: float, top: float, size: float) -> None:
    """Danger triangle (Vienna Convention, Annex 1): a hump for a bump, uneven road for several holes; own drawing."""

    def at(x: float, y: float) -> tuple[float, float]:
        return left + x * size, top + y * size

    triangle = _polygon([at(0.5, 0.07), at(0.97, 0.89), at(0.03, 0.89)])
    canvas.drawPath(triangle, _paint(SIGN_WHITE))
    canvas.drawPath(triangle, _stroke(SIGN_RED, 0.105 * size))
    ink = _paint(0xFF111111)
    for pictogram in _pictogram(card):
        canvas.drawPath(_polygon([at(x, y) for x, y in pictogram]), ink)


def _pictogram(card: Card) -> list[list[tuple[float, float]]]:
    x = np.linspace(0.0, 1.0, 25)
    if card.kind is Kind.DEBRIS:
        road = [(0.24, 0.76), (0.76, 0.76), (0.76, 0.71), (0.24, 0.71)]
        return [road, [(0.36, 0.71), (0.38, 0.56), (0.52, 0.52), (0.66, 0.6), (0.64, 0.71)]]
    if card.kind is Kind.BUMP:
        surface = 0.70 - 0.17 * np.clip(np.sin(np.pi * (x - 0.2) / 0.6), 0, None)
    elif card.group:
        surface = 0.64 + 0.07 * np.cos(4 * np.pi * x)
    else:
        surface = 0.62 + 0.13 * np.clip(np.sin(np.pi * (x - 0.25) / 0.5), 0, None)
    us = 0.23 + 0.54 * x
    return [[*zip(us, surface, strict=True), (0.77, 0.79), (0.23, 0.79)]]


def _draw_status(canvas: Any, status: str, height_px: int, text_px: float) -> None:
    font = skia.Font(_typeface(), text_px)
    width = font.measureText(status) + 1.2 * text_px
    plate = skia.Rect.MakeXYWH(0.8 * text_px, height_px - 2.4 * text_px, width, 1.6 * text_px)
    canvas.drawRoundRect(plate, 0.5 * text_px, 0.5 * text_px, _paint(PLATE))
    canvas.drawString(status, 1.4 * text_px, height_px - 1.25 * text_px, font, _paint(INK))


def _text_centred(canvas: Any, text: str, u: float, v: float, font: Any, colour: int) -> None:
    canvas.drawString(text, u - font.measureText(text) / 2, v, font, _paint(colour))


@cache
def _typeface() -> Any:
    # matplotlib ships DejaVu, so that a car without fonts draws the same text.
    import matplotlib as mpl

    path = Path(mpl.get_data_path()) / "fonts" / "ttf" / "DejaVuSans-Bold.ttf"
    typeface = skia.FontMgr.New_Custom_Empty().makeFromFile(str(path))
    if typeface is None:
        raise RuntimeError(f"the bundled font {path.name} cannot be read; reinstall matplotlib")
    return typeface
