"""What is kept of a drive: decisions, and when the car knew what; matched to the truth of the street only here."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from uuid import UUID

import numpy as np
from numpy.typing import NDArray

from contract.geometry import LatLon
from contract.observation import Detection, DetectionResult, Inspection, InspectionResult
from contract.obstacle import ObstacleFeature
from simulator.streets.street import Street
from vehicle_client.alerts import Stage
from vehicle_client.alignment import Alignment, align
from vehicle_client.drive import Answer, Step
from vehicle_client.frames import Matrix, Vector, apply, inverse, rigid
from vehicle_client.positioning.pose import Pose
from vehicle_client.sensing.calibration import VehicleCalibration

SAME_PLACE_M = 7.0
"""A position within this of a true obstacle is that obstacle: the demo's are 20 m apart, satellites err by 1 m."""

CLOUD_EVERY = 2
CLOUD_RANGE_M = 12.0
CLOUD_RELIEF_M = 0.03
"""Of every second sweep, what lies off the road's surface near the car: enough to see two clouds lie on each other."""


@dataclass(frozen=True, slots=True)
class DecisionRow:
    """One line of the table: what the server decided about one detection or inspection of one car."""

    car: str
    obstacle: str
    decision: str
    version: int | None
    state: str
    detail: str
    obstacle_id: UUID | None


@dataclass(frozen=True, slots=True)
class Moment:
    """Where along the street and when in the drive something happened."""

    street_x_m: float
    time_s: float


@dataclass(slots=True)
class Knowledge:
    """When a car learnt of one obstacle: told by the server, advised and warned the driver, saw it itself."""

    told: Moment | None = None
    advised: Moment | None = None
    warned: Moment | None = None
    seen: Moment | None = None


@dataclass(slots=True)
class DriveRecord:
    """One car's drive past the street's obstacles."""

    car: str
    street: Street
    calibration: VehicleCalibration
    speed_mps: float
    rows: list[DecisionRow] = field(default_factory=list)
    knowledge: dict[str, Knowledge] = field(default_factory=dict)
    clouds: list[NDArray[np.float32]] = field(default_factory=list)
    travelled_x_m: list[float] = field(default_factory=list)
    first_told: dict[UUID, ObstacleFeature] = field(default_factory=dict)
    alignment: Alignment = field(default_factory=Alignment)
    started_s: float | None = None

    def note(self, step: Step, street_x_m: float) -> None:
        """Keep what a step shows."""
        if self.started_s is None:
            self.started_s = step.frame.stamp_s
        self.travelled_x_m.append(street_x_m)
        self.note_answers(step.answers)
        if step.pose is None:
            return
        street_from_enu = self.street_from_enu(step.pose)
        now = Moment(street_x_m, step.frame.stamp_s - self.started_s)
        self._note_told(step, now)
        self._note_alerts(step, street_from_enu @ step.pose.enu_from_vehicle, now)
        self._note_tracks(step, street_from_enu @ step.pose.enu_from_odom, now)
        self._note_alignment(step, step.pose)
        if len(self.travelled_x_m) % CLOUD_EVERY == 0:
            self._note_cloud(step, street_from_enu @ step.pose.enu_from_vehicle)

    def note_answers(self, answers: tuple[Answer, ...]) -> None:
        """Keep the server's decisions in their order."""
        self.rows += [row for answer in answers for row in self._rows(answer)]

    def street_from_enu(self, pose: Pose) -> Matrix:
        """(4, 4) from a car's own `enu` frame, about its first fix, to the street."""
        origin = self.street.georeference.enu_from_geodetic(pose.origin.position, pose.origin.altitude_m)
        # The axes of two east-north-up frames 300 m apart differ by 5e-5 rad: 2 cm over the demo's street.
        return inverse(self.street.enu_from_street) @ rigid(np.eye(3), origin)

    def name_at(self, street_xy_m: Vector) -> str | None:
        """Name of the true obstacle at a position of the street, None if there is none."""
        for placed in self.street.obstacles:
            if np.hypot(street_xy_m[0] - placed.x_m, street_xy_m[1] - placed.y_m) < SAME_PLACE_M:
                return true_name(self.street, placed.obstacle_id)
        return None

    def name_of(self, position: LatLon) -> str | None:
        """Name of the true obstacle at a WGS 84 position."""
        georeference = self.street.georeference
        enu = georeference.enu_from_geodetic(position, georeference.altitude_m)
        return self.name_at(apply(inverse(self.street.enu_from_street), enu))

    def _rows(self, answer: Answer) -> Iterator[DecisionRow]:
        report, result = answer.report, answer.result
        for detection, decided in zip(report.detections, result.detections, strict=True):
            yield self._detection_row(detection, decided, answer)
        for inspection, counted in zip(report.inspections, result.inspections, strict=True):
            yield self._inspection_row(inspection, counted)

    def _detection_row(self, detection: Detection, decided: DetectionResult, answer: Answer) -> DecisionRow:
        georeference, origin = self.street.georeference, answer.report.origin
        enu = georeference.enu_from_geodetic(origin.position, origin.altitude_m)
        place = apply(inverse(self.street.enu_from_street), enu + np.array([detection.east_m, detection.north_m, 0.0]))
        box = detection.box
        size = f"{box.length_mm / 10:.0f} x {box.width_mm / 10:.0f} cm, {box.relief_mm / 10:.0f} cm"
        depth = "deep" if detection.sign.value == "negative" else "high"
        return DecisionRow(
            car=self.car,
            obstacle=self.name_at(place) or f"no obstacle ({detection.kind.value})",
            decision=decided.decision.value,
            version=decided.version,
            state=decided.state.value if decided.state else "",
            detail=f"{size} {depth}; {decided.reason}",
            obstacle_id=decided.obstacle_id,
        )

    def _inspection_row(self, inspection: Inspection, counted: InspectionResult) -> DecisionRow:
        return DecisionRow(
            car=self.car,
            obstacle="",
            decision="removed" if counted.removed else inspection.outcome.value,
            version=None,
            state="removed" if counted.removed else "",
            detail=f"inspection: {inspection.visible_fraction:.0%} of the place seen; {counted.why}",
            obstacle_id=inspection.obstacle_id,
        )

    def _note_told(self, step: Step, now: Moment) -> None:
        for entry in step.known.obstacles.values():
            name = self.name_of(entry.feature.position)
            if name is not None and self._of(name).told is None:
                self._of(name).told = now

    def _note_alerts(self, step: Step, street_from_vehicle: Matrix, now: Moment) -> None:
        for hazard in step.alerts.hazards:
            name = self.name_at(apply(street_from_vehicle, hazard.centre_vehicle_m))
            if name is None or hazard.obstacle_id is None:
                continue
            known = self._of(name)
            if hazard.stage >= Stage.ADVISE and known.advised is None:
                known.advised = now
            if hazard.stage >= Stage.WARN and known.warned is None:
                known.warned = now

    def _note_tracks(self, step: Step, street_from_odom: Matrix, now: Moment) -> None:
        for track in step.tracks:
            name = self.name_at(apply(street_from_odom, track.centre_odom_m))
            if name is None or not track.confirmed or self._of(name).seen is not None:
                continue
            # The first sweep that showed it, not the third that made the track believed: the stricter lead.
            ago_s = step.frame.stamp_s - track.first_stamp_s
            self._of(name).seen = Moment(now.street_x_m - ago_s * self.speed_mps, now.time_s - ago_s)

    def _note_alignment(self, step: Step, pose: Pose) -> None:
        for obstacle_id, entry in step.known.obstacles.items():
            self.first_told.setdefault(obstacle_id, entry.feature)
        latest = align(list(self.first_told.values()), step.tracks, pose)
        if latest.pairs > self.alignment.pairs:
            shift = pose.enu_from_odom[:2, :2] @ latest.shift_m
            street_shift = self.street.enu_from_street[:2, :2].T @ shift
            self.alignment = Alignment(street_shift, latest.pairs)

    def _note_cloud(self, step: Step, street_from_vehicle: Matrix) -> None:
        points, residual = step.frame.points_m, step.detection.residual_m
        near = np.hypot(points[:, 0], points[:, 1]) < CLOUD_RANGE_M
        kept = near & np.isfinite(residual) & (np.abs(residual) > CLOUD_RELIEF_M)
        street_from_sensor = street_from_vehicle @ self.calibration.vehicle_from_sensor
        self.clouds.append(apply(street_from_sensor, points[kept]).astype(np.float32))

    def _of(self, name: str) -> Knowledge:
        return self.knowledge.setdefault(name, Knowledge())


def true_name(street: Street, obstacle_id: int) -> str:
    """How the report calls an obstacle: its kind, with a number where there are several of it."""
    kind = street.obstacle(obstacle_id).kind
    same = [o.obstacle_id for o in street.obstacles if o.kind is kind]
    return kind.value if len(same) == 1 else f"{kind.value} {same.index(obstacle_id) + 1}"
