"""A report on its way to its decision: who sent it, when it came, and whether it is believed."""

from __future__ import annotations

import hashlib
from collections.abc import Container
from dataclasses import dataclass
from datetime import datetime
from uuid import UUID

from contract.observation import ObservationReport
from server import rules
from server.life.plausibility import clock_correction, report_rejection
from server.life.policy import Policy


@dataclass(frozen=True, slots=True)
class Parcel:
    """A report, who sent it, when it was received, and its canonical text."""

    message: ObservationReport
    sent_at: datetime
    received_at: datetime
    key_id: str
    witness: str
    body: str

    @property
    def name(self) -> tuple[str, UUID]:
        """What makes it one report: the key and the id that the vehicle gave it."""
        return self.key_id, self.message.report_id

    @property
    def body_sha256(self) -> str:
        """Tells a repetition from another report under the same id."""
        return hashlib.sha256(self.body.encode()).hexdigest()


def opened(parcel: Parcel, policy: Policy, distrusted: Container[str]) -> rules.Report | str:
    """The report at its corrected time, or why it is rejected as a whole; `distrusted` are names of witnesses."""
    correction = clock_correction(parcel.sent_at, parcel.received_at, policy.times)
    if correction is None:
        return "clock-skew"
    age = parcel.received_at - parcel.message.observed_at - correction
    if rejection := report_rejection(parcel.message, age, policy.plausibility, policy.times):
        return rejection
    return rules.Report(
        parcel.message,
        parcel.received_at - age,
        parcel.key_id,
        parcel.witness,
        trusted=parcel.witness not in distrusted,
    )
