"""What a vehicle sends: one report a pass, with what it saw and what it looked for; and what it is answered."""

from __future__ import annotations

import math
from enum import StrEnum
from typing import Annotated
from uuid import UUID

from pydantic import Field

from contract.geometry import Box, BoxSd, Kind, LatLon, Message, PlaneCovariance, Sign, UtcDatetime

MAX_POINTS = 512
MAX_REPORTS = 100
MAX_DETECTIONS = 64
MAX_INSPECTIONS = 256
MAX_BODY_BYTES = 1 << 20

Name = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9._:-]*$")]
Centimetres = Annotated[int, Field(ge=-5_000, le=5_000)]


class Descriptor(Message):
    """Named numbers of a shape that survive rotation and a change of density; compared by name and version."""

    name: Name
    version: Annotated[int, Field(ge=1, le=1_000)]
    # Without it the schema would let any other name through.
    values: Annotated[dict[Name, float], Field(max_length=64, json_schema_extra={"additionalProperties": False})]


class View(Message):
    """How a size was measured; only equal views are compared and fused (front-only boxes come out smaller)."""

    front: bool = Field(description="seen while approaching")
    rear: bool = Field(description="seen after passing")
    hits: Annotated[int, Field(ge=1, le=10_000_000)]
    frames: Annotated[int, Field(ge=1, le=100_000)]
    least_range_m: Annotated[float, Field(ge=0, le=500)]


class Origin(Message):
    """Place of the vehicle that a report's offsets are relative to, kept coarse: one place a report, no trajectory.

    `covariance` is the pose error that all detections of the report share; `heading_rad` is clockwise from north.
    """

    position: LatLon
    altitude_m: Annotated[float, Field(ge=-1_000, le=10_000)]
    altitude_sd_m: Annotated[float, Field(ge=0, le=1_000)]
    heading_rad: Annotated[float, Field(ge=0, lt=2 * math.pi)]
    covariance: PlaneCovariance


class Detection(Message):
    """One obstacle as one pass measured it. Offsets are east and north of the report's origin, of the box's centre."""

    kind: Kind
    east_m: Annotated[float, Field(ge=-500, le=500)]
    north_m: Annotated[float, Field(ge=-500, le=500)]
    up_m: Annotated[float, Field(ge=-100, le=100)] = 0.0
    covariance: PlaneCovariance = Field(description="of this centre relative to the vehicle, without the pose error")
    box: Box
    box_sd: BoxSd
    volume_m3: Annotated[float, Field(ge=0, le=1_000)]
    confidence: Annotated[float, Field(ge=0, le=1)]
    view: View
    descriptor: Descriptor
    points_cm: Annotated[
        tuple[tuple[Centimetres, Centimetres, Centimetres], ...],
        Field(max_length=MAX_POINTS, description="voxel-thinned points relative to the centre: east, north, up in cm"),
    ] = ()

    @property
    def sign(self) -> Sign:
        """Sign of the detection's kind."""
        return self.kind.sign


class Outcome(StrEnum):
    """What a vehicle found at the place of a known obstacle."""

    PRESENT = "present"
    ABSENT = "absent"
    NOT_VISIBLE = "not_visible"


class Inspection(Message):
    """A look at the place of a known obstacle, made by every vehicle that passes it, also when it detected nothing."""

    obstacle_id: UUID
    outcome: Outcome
    visible_fraction: Annotated[float, Field(ge=0, le=1, description="share of the footprint that was seen")]


class ObservationReport(Message):
    """What one vehicle observed at one time. `report_id` is made by the vehicle, so that a retry is harmless."""

    report_id: UUID
    observed_at: UtcDatetime
    pseudonym: Name
    sensor: Name = Field(description="class of the sensor, since sensors differ in what they see")
    estimator: Name = Field(description="name and version of what measured the boxes")
    origin: Origin
    detections: Annotated[tuple[Detection, ...], Field(max_length=MAX_DETECTIONS)] = ()
    inspections: Annotated[tuple[Inspection, ...], Field(max_length=MAX_INSPECTIONS)] = ()


class ObservationBatch(Message):
    """Body of `POST /v1/observations`. `sent_at` is the vehicle's clock when it sent, and corrects a skewed one."""

    sent_at: UtcDatetime
    reports: Annotated[tuple[ObservationReport, ...], Field(min_length=1, max_length=MAX_REPORTS)]


class ReportStatus(StrEnum):
    """What became of a report."""

    ACCEPTED = "accepted"
    DUPLICATE = "duplicate"
    REJECTED = "rejected"
    RETRY = "retry"


class DecisionKind(StrEnum):
    """What the rule decided about one detection."""

    CREATED = "created"
    KEPT = "kept"
    UPDATED = "updated"
    REJECTED = "rejected"
    SUPERSEDED = "superseded"


class State(StrEnum):
    """Where an obstacle is in its life."""

    CANDIDATE = "candidate"
    CONFIRMED = "confirmed"
    REMOVED = "removed"


class DetectionResult(Message):
    """The decision about one detection, and the obstacle as it is served after it (absent when rejected)."""

    decision: DecisionKind
    reason: str
    obstacle_id: UUID | None = None
    version: int | None = None
    revision: int | None = None
    state: State | None = None
    position: LatLon | None = None
    position_sd_m: float | None = None
    box: Box | None = None


class InspectionResult(Message):
    """Whether an inspection counted, why, and whether it removed the obstacle."""

    obstacle_id: UUID
    counted: bool
    why: str
    removed: bool = False


class ReportResult(Message):
    """Answer to one report, in the order of the batch; detections and inspections in the order of the report."""

    report_id: UUID
    status: ReportStatus
    reason: str | None = None
    detections: tuple[DetectionResult, ...] = ()
    inspections: tuple[InspectionResult, ...] = ()


class ObservationBatchResult(Message):
    """Answer to `POST /v1/observations`."""

    results: tuple[ReportResult, ...]
