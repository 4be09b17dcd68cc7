"""What of a report and of a position leaves the car: no more than others need to be warned."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from uuid import UUID

import numpy as np

from contract.geometry import LatLon
from contract.observation import Detection, Inspection, ObservationReport
from vehicle_client.frames import GeoOrigin
from vehicle_client.privacy.pseudonym import Pseudonyms
from vehicle_client.privacy.quiet_zones import QuietZone, is_hidden

ORIGIN_GRID_DEG = 0.0003
"""33 m, and no more: a report is made 6 to 18 m from what it speaks of (`moments.ABOUT_TO_PASS_M`,
`watching.INSPECTED_M`), and that place is exact, since it is what others are warned of. A wider grid would hide nothing
that the report does not say, but the server would have to search three times the area (100 m) for each report, believe
it of places 200 m away, and take two cars 160 m apart for one (`Plausibility.speed_slack_m` is 50 m; the diagonal here
is 47 m)."""

POSITION_GRID_DEG = 0.001
"""111 m: what is asked about is 600 m around."""

HEADINGS = 8
"""The server decides nothing by a report's heading; the contract asks for one."""

REACH_M = 120.0
"""Within this a report may speak of a place (the server's own limit)."""

Places = Callable[[UUID], LatLon | None]
"""Where a known obstacle lies; None when that is not known."""


@dataclass(frozen=True, slots=True)
class Privacy:
    """What a vehicle keeps to itself: quiet zones, and its names (without: the one that a report brings)."""

    zones: tuple[QuietZone, ...] = ()
    pseudonyms: Pseudonyms | None = None


def coarse(position: LatLon, grid_deg: float) -> LatLon:
    """The nearest point of a grid over the earth."""
    return LatLon(
        latitude_deg=_on_grid(position.latitude_deg, grid_deg, 90.0),
        longitude_deg=_on_grid(position.longitude_deg, grid_deg, 180.0),
    )


def position_told(position: LatLon, privacy: Privacy) -> LatLon | None:
    """What the server is told of the car's position: a coarse one; None in a quiet zone or at its edge."""
    told = coarse(position, POSITION_GRID_DEG)
    if is_hidden(position, privacy.zones) or is_hidden(told, privacy.zones):
        return None
    return told


def departing(report: ObservationReport, privacy: Privacy, place_of: Places) -> ObservationReport | None:
    """The report as it leaves the car: nothing in quiet zones, a coarse origin and heading, the name of the moment.

    None when nothing of it may leave, or nothing is left of it.
    """
    here = coarse(report.origin.position, ORIGIN_GRID_DEG)
    if is_hidden(report.origin.position, privacy.zones) or is_hidden(here, privacy.zones):
        return None
    detections = tuple(d for d in report.detections if not is_hidden(_place_of(d, report), privacy.zones))
    inspections = tuple(i for i in report.inspections if not _is_secret(i, report, privacy, place_of))
    if not detections and not inspections:
        return None
    heading_rad = _coarse_heading(report.origin.heading_rad)
    names = privacy.pseudonyms
    return report.model_copy(
        update={
            "pseudonym": report.pseudonym if names is None else names.at(report.observed_at.timestamp()),
            "origin": report.origin.model_copy(update={"position": here, "heading_rad": heading_rad}),
            "detections": tuple(_seen_from(here, d, report) for d in detections),
            "inspections": inspections,
        }
    )


def _is_secret(inspection: Inspection, report: ObservationReport, privacy: Privacy, place_of: Places) -> bool:
    place = place_of(inspection.obstacle_id)
    if place is None:
        return is_hidden(report.origin.position, privacy.zones, margin_m=REACH_M)
    return is_hidden(place, privacy.zones)


def _place_of(detection: Detection, report: ObservationReport) -> LatLon:
    return _geodetic(detection, report)[0]


def _geodetic(detection: Detection, report: ObservationReport) -> tuple[LatLon, float]:
    origin = GeoOrigin(report.origin.position, report.origin.altitude_m)
    return origin.geodetic(np.array([detection.east_m, detection.north_m, detection.up_m]))


def _seen_from(here: LatLon, detection: Detection, report: ObservationReport) -> Detection:
    east_m, north_m, up_m = GeoOrigin(here, report.origin.altitude_m).enu(*_geodetic(detection, report))
    return detection.model_copy(update={"east_m": float(east_m), "north_m": float(north_m), "up_m": float(up_m)})


def _coarse_heading(heading_rad: float) -> float:
    step_rad = 2 * math.pi / HEADINGS
    return round(heading_rad / step_rad) % HEADINGS * step_rad


def _on_grid(value_deg: float, grid_deg: float, limit_deg: float) -> float:
    # Seven digits: a centimetre, and no tail of rounding on the wire.
    on_grid = round(round(value_deg / grid_deg) * grid_deg, 7)
    return max(-limit_deg, min(limit_deg, on_grid))
