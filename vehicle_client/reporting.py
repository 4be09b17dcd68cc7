"""What the car tells the server, as values: measured obstacles and inspections of known places become one report."""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from uuid import UUID

import numpy as np

from contract.geometry import Box, BoxSd, Kind, PlaneCovariance, Sign
from contract.observation import (
    Descriptor,
    Detection,
    Inspection,
    ObservationReport,
    Origin,
    Outcome,
    View,
)
from contract.obstacle import ObstacleFeature
from detector.passes.inspection import KnownPlace, PlaceVerdict
from detector.types import DetectedObstacle
from vehicle_client.alignment import Alignment
from vehicle_client.frames import GeoOrigin, apply, axis_yaw, inverse, yaw_of
from vehicle_client.obstacle_map import stored_sd_m
from vehicle_client.positioning.pose import Pose

_LOG = logging.getLogger(__name__)

ESTIMATOR = "ray-contour:2"
"""Name and version of the estimator of `detector.passes.shape`; the server compares only what was measured alike."""


def known_place(feature: ObstacleFeature, pose: Pose, alignment: Alignment) -> KnownPlace:
    """A known obstacle as the detector inspects it: in `odom`, laid on what the car sees, with what remains unsure."""
    properties = feature.properties
    centre_enu = pose.origin.enu(feature.position, properties.altitude_m)
    shift = np.array([*alignment.shift_m, 0.0])
    return KnownPlace(
        centre_odom_m=apply(inverse(pose.enu_from_odom), centre_enu) + shift,
        length_m=properties.box.length_mm / 1000,
        width_m=properties.box.width_mm / 1000,
        yaw_rad=axis_yaw(properties.box.yaw_rad - yaw_of(pose.enu_from_odom)),
        relief_m=properties.box.relief_mm / 1000,
        is_negative=properties.sign is Sign.NEGATIVE,
        place_sd_m=alignment.place_sd_m(stored_sd_m(feature), pose.sd_m),
    )


def weighed(verdict: PlaceVerdict, *, sighted: bool) -> PlaceVerdict:
    """The verdict about a known place: what the server matched to a detection of this pass is there, wherever the map
    puts it."""
    return replace(verdict, outcome="present", reason="matched to a detection of this pass") if sighted else verdict


def compose_report(
    report_id: UUID,
    pose: Pose,
    measured: Sequence[DetectedObstacle],
    verdicts: Sequence[tuple[UUID, PlaceVerdict]],
    *,
    pseudonym: str,
    sensor: str,
) -> ObservationReport:
    """One report of what a pass showed; obstacles are given in `odom`, their places leave relative to the car."""
    position, altitude_m = pose.position, pose.altitude_m
    return ObservationReport(
        report_id=report_id,
        observed_at=datetime.fromtimestamp(pose.stamp_s, UTC),
        pseudonym=pseudonym,
        sensor=sensor,
        estimator=ESTIMATOR,
        origin=Origin(
            position=position,
            altitude_m=altitude_m,
            altitude_sd_m=pose.altitude_sd_m,
            heading_rad=pose.heading_rad,
            covariance=PlaneCovariance(
                east_m2=float(pose.covariance_m2[0, 0]),
                north_m2=float(pose.covariance_m2[1, 1]),
                east_north_m2=float(pose.covariance_m2[0, 1]),
            ),
        ),
        detections=detections_of(measured, pose),
        inspections=tuple(
            Inspection(obstacle_id=i, outcome=Outcome(v.outcome), visible_fraction=v.visible_fraction)
            for i, v in verdicts
        ),
    )


def detections_of(measured: Sequence[DetectedObstacle], pose: Pose) -> tuple[Detection, ...]:
    """Those that the contract takes; one that it does not is left out with a warning, and does not stop the car."""
    detections = []
    for obstacle in measured:
        try:
            detections.append(detection_of(obstacle, pose))
        except (ValueError, OverflowError) as error:  # pydantic's are values' errors too; NaN and infinity are
            _LOG.warning("a measured obstacle cannot be reported: %s", " ".join(str(error).split())[:200])
    return tuple(detections)


def detection_of(obstacle: DetectedObstacle, pose: Pose) -> Detection:
    """A measured obstacle in `odom` as the contract's detection: east, north, up from the car."""
    obstacle = _longer_first(obstacle)
    turn = pose.enu_from_odom[:3, :3]
    # Through WGS 84, since the report is relative to the car, and its horizon is not that of the drive's origin.
    offset = GeoOrigin(pose.position, pose.altitude_m).enu(
        *pose.origin.geodetic(apply(pose.enu_from_odom, obstacle.centre_m))
    )
    covariance = turn[:2, :2] @ obstacle.centre_covariance_m2 @ turn[:2, :2].T
    length_mm, width_mm = round(obstacle.length_m * 1000), round(obstacle.width_m * 1000)
    points_cm = np.rint(obstacle.points_m.astype(np.float64) @ turn.T * 100).astype(int)
    return Detection(
        kind=Kind(obstacle.kind),
        east_m=float(offset[0]),
        north_m=float(offset[1]),
        up_m=float(offset[2]),
        covariance=PlaneCovariance(
            east_m2=float(covariance[0, 0]),
            north_m2=float(covariance[1, 1]),
            east_north_m2=float(covariance[0, 1]),
        ),
        box=Box(
            length_mm=max(length_mm, 1),
            width_mm=max(width_mm, 1),
            yaw_rad=axis_yaw(obstacle.yaw_rad + yaw_of(pose.enu_from_odom)),
            relief_mm=round(obstacle.relief_m * 1000),
        ),
        box_sd=BoxSd(
            ln_length=obstacle.ln_length_sd,
            ln_width=obstacle.ln_width_sd,
            ln_area=obstacle.ln_area_sd,
            relief_mm=obstacle.relief_sd_m * 1000,
        ),
        volume_m3=obstacle.volume_m3,
        confidence=obstacle.confidence,
        view=View(
            front=obstacle.view_front,
            rear=obstacle.view_rear,
            hits=obstacle.hits,
            frames=obstacle.frames,
            least_range_m=obstacle.least_range_m,
        ),
        descriptor=Descriptor(
            name=obstacle.descriptor.name, version=obstacle.descriptor.version, values=obstacle.descriptor.values
        ),
        points_cm=tuple((int(e), int(n), int(u)) for e, n, u in points_cm),
    )


def _longer_first(obstacle: DetectedObstacle) -> DetectedObstacle:
    """The obstacle with the longer side as its length: sides are estimated apart, and nearly round ones cross over."""
    if obstacle.length_m >= obstacle.width_m:
        return obstacle
    return replace(
        obstacle,
        length_m=obstacle.width_m,
        width_m=obstacle.length_m,
        ln_length_sd=obstacle.ln_width_sd,
        ln_width_sd=obstacle.ln_length_sd,
        yaw_rad=axis_yaw(obstacle.yaw_rad + math.pi / 2),
    )
