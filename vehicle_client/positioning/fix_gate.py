"""Which fixes are believed: a receiver that jumps, freezes or stands elsewhere must not drag the pose with it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from contract.geometry import LatLon
from vehicle_client.frames import Matrix, Vector

GATE = 16.0
"""Squared distance in standard deviations of the innovation; a right fix is beyond it once in 3,000 (chi-square, 2)."""

AGREED_AFTER_S, AGREED_FIXES = 5.0, 5
"""Rejected fixes that agree so long are right after all; reflections off buildings change within a second or two as the
car passes them."""

LOST_AFTER_S = 20.0
"""When nothing was believed so long while fixes came, it is the pose that is wrong: it begins anew."""

SILENT_S = 5.0
"""What was refused before a longer silence (a tunnel, whose mouth reflects) says nothing of the fixes after it."""

FROZEN_M = 2.0
"""The very same digits though the car moved so far: no receiver's noise is that small."""


class Verdict(Enum):
    """What becomes of a fix."""

    BELIEVED = "believed"
    REJECTED = "rejected"
    AGREED = "agreed"
    LOST = "lost"


@dataclass(frozen=True, slots=True)
class Rejected:
    """A fix that was not believed: by how much (2,) it was off."""

    stamp_s: float
    innovation_m: Vector


@dataclass(frozen=True, slots=True)
class FixGate:
    """What is remembered of the last fixes."""

    agreeing: tuple[Rejected, ...] = ()
    refused_since_s: float | None = None
    held: LatLon | None = None
    held_at_odom_m: Vector | None = None

    @property
    def last_refused_s(self) -> float | None:
        """When the last fix was that was not believed; None if one has been believed since."""
        return self.agreeing[-1].stamp_s if self.agreeing else None

    def sees(self, position: LatLon, odom_m: Vector) -> tuple[FixGate, bool]:
        """The gate after a position came in at a place (3,) in `odom`, and whether the receiver has frozen."""
        if position != self.held or self.held_at_odom_m is None:
            return replace(self, held=position, held_at_odom_m=odom_m), False
        return self, bool(np.linalg.norm(odom_m[:2] - self.held_at_odom_m[:2]) > FROZEN_M)

    def judges(
        self, stamp_s: float, innovation_m: Vector, covariance_m2: Matrix, sd_m: float
    ) -> tuple[FixGate, Verdict]:
        """The gate after an innovation (2,) with its covariance (2, 2), and what becomes of the fix."""
        if float(innovation_m @ np.linalg.solve(covariance_m2, innovation_m)) <= GATE:
            return replace(self, agreeing=(), refused_since_s=None), Verdict.BELIEVED
        last_s = self.last_refused_s
        if last_s is not None and stamp_s - last_s > SILENT_S:
            return replace(self, agreeing=(), refused_since_s=None).judges(stamp_s, innovation_m, covariance_m2, sd_m)
        since_s = stamp_s if self.refused_since_s is None else self.refused_since_s
        agreeing = (*self._that_agree(innovation_m, sd_m), Rejected(stamp_s, innovation_m))
        if len(agreeing) >= AGREED_FIXES and stamp_s - agreeing[0].stamp_s >= AGREED_AFTER_S:
            return replace(self, agreeing=(), refused_since_s=None), Verdict.AGREED
        if stamp_s - since_s >= LOST_AFTER_S:
            return FixGate(), Verdict.LOST
        return replace(self, agreeing=agreeing, refused_since_s=since_s), Verdict.REJECTED

    def _that_agree(self, innovation_m: Vector, sd_m: float) -> tuple[Rejected, ...]:
        """The refused fixes so far, if this one says the same: all together, or it is the first of others."""
        if not self.agreeing:
            return ()
        mean = np.mean([r.innovation_m for r in self.agreeing], axis=0)
        agrees = float(np.linalg.norm(innovation_m - mean)) <= GATE**0.5 * sd_m
        # The first tells since when they agree; of the others the last few are enough.
        return self.agreeing[:1] + self.agreeing[1:][-AGREED_FIXES:] if agrees else ()
