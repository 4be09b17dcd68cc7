"""The demo's report: one HTML file that needs nothing beside it."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path

import cv2
import jinja2

from contract.obstacle import ObstacleCollection
from headsup.demo import plots
from headsup.demo.pictures import Album
from headsup.demo.record import DriveRecord
from headsup.demo.summary import WARNED_CAR, Summary

JPEG_QUALITY = 86


def write_report(
    path: Path,
    summary: Summary,
    records: Sequence[DriveRecord],
    obstacles: ObstacleCollection,
    album: Album,
    *,
    film_path: Path | None,
) -> None:
    """Write the page: pictures and film inside it, the plan, the clouds, the decisions and the leads."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("headsup.demo", "templates"), autoescape=True, undefined=jinja2.StrictUndefined
    )
    by_car = {record.car: record for record in records}
    street = records[0].street
    page = environment.get_template("report.html").render(
        summary=summary,
        stills=[(caption, _jpeg(path.parent / name)) for name, caption in album.stills.items()],
        film=_encoded(film_path) if film_path is not None else None,
        plan=plots.street_plan(street, records, obstacles),
        clouds=plots.clouds(street, records[0], by_car[WARNED_CAR]),
    )
    path.write_text(page, encoding="utf-8")


def _jpeg(path: Path) -> str:
    image = cv2.imread(str(path))
    if image is None:
        raise OSError(f"{path} cannot be read back")
    done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not done:
        raise OSError(f"{path} cannot be encoded as JPEG")
    return base64.b64encode(data.tobytes()).decode()


def _encoded(path: Path) -> str:
    return base64.b64encode(path.read_bytes()).decode()
