"""The outbox against a model of itself, whatever is done to it in whatever order."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from uuid import UUID

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import Bundle, RuleBasedStateMachine, invariant, precondition, rule

from contract.observation import ObservationReport, ReportResult, ReportStatus
from tests.unit.vehicle_client.outbox_making import answered, look, reports, waiting_in
from vehicle_client.link.outbox import Outbox


class OutboxMachine(RuleBasedStateMachine):
    """An outbox that is put to, answered, closed and opened in any order holds what a list would."""

    Put = Bundle("Put")

    def __init__(self) -> None:
        super().__init__()
        self.folder = Path(tempfile.mkdtemp())
        self.outbox = Outbox(self.folder / "outbox.sqlite3")
        self.model: list[UUID] = []
        self.fates = 0
        self.made = 0

    @rule(target=Put, sees=st.booleans())
    def put(self, sees: bool) -> ObservationReport:
        self.made += 1
        report = reports(1, first=self.made)[0] if sees else look(self.made)
        self.outbox.put(report)
        self.model.append(report.report_id)
        return report

    @rule(report=Put, status=st.sampled_from(["accepted", "duplicate", "rejected"]))
    def settle(self, report: ObservationReport, status: str) -> None:
        self.outbox.settle(answered(report, status=status))
        self.forget(report)

    @rule(report=Put)
    def drop(self, report: ObservationReport) -> None:
        self.outbox.drop(report.report_id, "422")
        self.forget(report)

    @rule()
    def reopen(self) -> None:
        self.outbox.close()
        self.outbox = Outbox(self.folder / "outbox.sqlite3")

    @precondition(lambda self: self.model)
    @rule()
    def answer_a_batch(self) -> None:
        for kept in self.outbox.batch(3):
            result = ReportResult(report_id=kept.report_id, status=ReportStatus.ACCEPTED)
            self.outbox.settle([result])
            self.model.remove(kept.report_id)
            self.fates += 1

    @invariant()
    def holds_what_is_not_answered(self) -> None:
        assert waiting_in(self.outbox) == self.model
        assert sum(self.outbox.counts.values()) == self.fates

    def forget(self, report: ObservationReport) -> None:
        if report.report_id in self.model:
            self.model.remove(report.report_id)
            self.fates += 1

    def teardown(self) -> None:
        self.outbox.close()
        shutil.rmtree(self.folder)


TestOutboxMachine = OutboxMachine.TestCase
TestOutboxMachine.settings = settings(max_examples=20, stateful_step_count=15, deadline=None)
