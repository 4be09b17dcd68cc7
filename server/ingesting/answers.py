"""What a vehicle is answered: decisions as results of the contract."""

from __future__ import annotations

from contract.observation import (
    DecisionKind,
    DetectionResult,
    Inspection,
    InspectionResult,
    ObservationReport,
    ReportResult,
    ReportStatus,
)
from server.geometry.symmetric import greatest_sd_m
from server.rules import Decision, Verdict


def accepted(report: ObservationReport, decisions: list[Decision]) -> ReportResult:
    """Answer to a report that was decided: detections first, then inspections, each in the report's order."""
    looks = decisions[len(report.detections) :]
    return ReportResult(
        report_id=report.report_id,
        status=ReportStatus.ACCEPTED,
        detections=tuple(_detection_result(decision) for decision in decisions[: len(report.detections)]),
        inspections=tuple(map(_inspection_result, report.inspections, looks)),
    )


def refused(report: ObservationReport, status: ReportStatus, reason: str) -> ReportResult:
    """Answer to a report as a whole."""
    return ReportResult(report_id=report.report_id, status=status, reason=reason)


def _detection_result(decision: Decision) -> DetectionResult:
    outcome, obstacle = DecisionKind(decision.outcome), decision.obstacle
    if obstacle is None:
        return DetectionResult(decision=outcome, reason=decision.reason)
    return DetectionResult(
        decision=outcome,
        reason=decision.reason,
        obstacle_id=obstacle.id,
        version=obstacle.version,
        revision=obstacle.revision,
        state=obstacle.state,
        position=obstacle.place.position,
        position_sd_m=greatest_sd_m(obstacle.place.covariance),
        box=obstacle.shape.box,
    )


def _inspection_result(inspection: Inspection, decision: Decision) -> InspectionResult:
    return InspectionResult(
        obstacle_id=inspection.obstacle_id,
        counted=decision.outcome is not Verdict.IGNORED,
        why=decision.reason,
        removed=decision.outcome is Verdict.REMOVED,
    )
