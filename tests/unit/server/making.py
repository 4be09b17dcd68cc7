"""Reports and obstacles for the server's tests."""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta
from uuid import UUID, uuid5

from contract.geometry import Box, BoxSd, Kind, LatLon, PlaneCovariance
from contract.observation import (
    Descriptor,
    Detection,
    Inspection,
    ObservationReport,
    Origin,
    Outcome,
    View,
)
from server.life.obstacle import Obstacle
from server.life.policy import COOPERATION, Policy
from server.rules import Decision, Report, decide

NOON = datetime(2026, 6, 1, 12, tzinfo=UTC)
HOUR = timedelta(hours=1)
PATRAS = LatLon(latitude_deg=38.2466, longitude_deg=21.7346)
_IDS = UUID("0198a000-0000-7000-8000-000000000000")


def detection(
    east_m: float = 10.0,
    north_m: float = 5.0,
    length_mm: int = 1000,
    width_mm: int = 700,
    *,
    relief_mm: int = 100,
    yaw_rad: float = 0.3,
    sd: float = 0.01,
    kind: Kind = Kind.POTHOLE,
    confidence: float = 0.9,
    front: bool = True,
    rear: bool = True,
    centre_sd_m: float = 0.05,
) -> Detection:
    return Detection(
        kind=kind,
        east_m=east_m,
        north_m=north_m,
        covariance=PlaneCovariance(east_m2=centre_sd_m**2, north_m2=centre_sd_m**2),
        box=Box(length_mm=length_mm, width_mm=width_mm, yaw_rad=yaw_rad % math.pi, relief_mm=relief_mm),
        box_sd=BoxSd(ln_length=sd, ln_width=sd, ln_area=sd * math.sqrt(2), relief_mm=3),
        volume_m3=0.02,
        confidence=confidence,
        view=View(front=front, rear=rear, hits=300, frames=12, least_range_m=4),
        descriptor=Descriptor(name="shape", version=1, values={"area": length_mm * width_mm / 1e6}),
    )


def message(
    *detections: Detection,
    inspections: tuple[Inspection, ...] = (),
    at: datetime = NOON,
    vehicle: str = "ego1",
    number: int = 0,
    position: LatLon = PATRAS,
    pose_sd_m: float = 1.0,
    altitude_m: float = 20.0,
    altitude_sd_m: float = 2.0,
) -> ObservationReport:
    return ObservationReport(
        report_id=uuid5(_IDS, f"{vehicle} {at.isoformat()} {number}"),
        observed_at=at,
        pseudonym=vehicle,
        sensor="lidar-64",
        estimator="moment-box-1",
        origin=Origin(
            position=position,
            altitude_m=altitude_m,
            altitude_sd_m=altitude_sd_m,
            heading_rad=0.0,
            covariance=PlaneCovariance(east_m2=pose_sd_m**2, north_m2=pose_sd_m**2),
        ),
        detections=detections,
        inspections=inspections,
    )


def absent(obstacle_id: UUID, visible_fraction: float = 1.0) -> Inspection:
    return Inspection(obstacle_id=obstacle_id, outcome=Outcome.ABSENT, visible_fraction=visible_fraction)


def present(obstacle_id: UUID) -> Inspection:
    return Inspection(obstacle_id=obstacle_id, outcome=Outcome.PRESENT, visible_fraction=1.0)


class Road:
    """What a database would hold: applies decisions in memory."""

    def __init__(self, policy: Policy = COOPERATION) -> None:
        self.policy = policy
        self.obstacles: dict[UUID, Obstacle] = {}
        self._number = 0

    def take(self, sent: ObservationReport, witness: str | None = None) -> list[Decision]:
        report = Report(sent, sent.observed_at, key_id=witness or sent.pseudonym, witness=witness or sent.pseudonym)
        decisions = decide(report, tuple(self.obstacles.values()), sent.observed_at, self.policy)
        for decision in decisions:
            if decision.obstacle is not None:
                self.obstacles[decision.obstacle.id] = decision.obstacle
        return decisions

    def sees(self, vehicle: str, at: datetime, *detections: Detection, **about: float) -> list[Decision]:
        self._number += 1
        return self.take(message(*detections, vehicle=vehicle, at=at, number=self._number, **about))  # type: ignore[arg-type]

    def misses(self, vehicle: str, at: datetime, obstacle_id: UUID, **about: float) -> Decision:
        self._number += 1
        looked = message(inspections=(absent(obstacle_id),), vehicle=vehicle, at=at, number=self._number, **about)  # type: ignore[arg-type]
        return self.take(looked)[0]

    @property
    def only(self) -> Obstacle:
        (obstacle,) = self.obstacles.values()
        return obstacle

    def served(self) -> dict[UUID, Obstacle]:
        """Obstacles without the evidence, which is not served."""
        return {key: value._replace(evidence=()) for key, value in self.obstacles.items()}


def kinds(decisions: list[Decision]) -> list[str]:
    return [decision.outcome.value for decision in decisions]


def two_passes(policy: Policy, first: Detection, second: Detection) -> tuple[Road, str]:
    road = Road(policy)
    road.sees("ego1", NOON, first)
    return road, kinds(road.sees("ego2", NOON + HOUR, second))[0]
