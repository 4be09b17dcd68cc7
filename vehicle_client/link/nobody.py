"""Stands where there is no server."""

from __future__ import annotations

from collections.abc import Sequence

from contract.geometry import LatLon
from contract.observation import ObservationReport, ReportResult
from vehicle_client.area import Heard


class NobodyLink:
    """Hears nothing, tells nobody."""

    def hear(self, position: LatLon) -> Sequence[Heard]:
        """Nothing."""
        return ()

    def put(self, report: ObservationReport) -> None:
        """It was counted; it goes nowhere."""

    def deliver(self) -> Sequence[ReportResult]:
        """Nothing."""
        return ()
