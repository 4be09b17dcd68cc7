"""Every number of the rule, with its reason; two sets of them, `COOPERATION` (the default) and `PAPER`."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from datetime import timedelta
from types import MappingProxyType
from typing import Literal

from contract.geometry import Kind

PolicyName = Literal["cooperation", "paper"]


def _half_lives_s() -> MappingProxyType[Kind, float]:
    day_s = 86_400.0
    return MappingProxyType({Kind.POTHOLE: 30 * day_s, Kind.BUMP: 180 * day_s, Kind.DEBRIS: 0.25 * day_s})


@dataclass(frozen=True, slots=True)
class Plausibility:
    """What a detection must satisfy to be believed at all."""

    least_side_mm: int = 50
    """Below the grid of a LiDAR at close range (0.1 m cells), nothing is measured."""
    greatest_side_mm: int = 20_000
    """A speed hump across four lanes."""
    least_relief_mm: int = 5
    """Half the range noise of a good LiDAR."""
    greatest_relief_mm: int = 3_000
    """The load of a lorry; deeper holes end the road."""
    least_confidence: float = 0.1
    """The detector itself does not believe less."""
    least_hits: int = 5
    """A plane needs three points, its scatter two more."""
    reach_m: float = 120.0
    """A 100 m LiDAR, and the lever from the vehicle's origin."""
    greatest_up_m: float = 20.0
    """A grade of 17 % over the reach."""
    greatest_pose_sd_m: float = 20.0
    """A GNSS fix worse than this cannot tell one street from the next; it also bounds what a report locks."""
    greatest_centre_sd_m: float = 5.0
    """Wider than a lane: not a measurement of one obstacle."""
    greatest_speed_mps: float = 100.0
    """360 km/h: no car on a road."""
    speed_window_s: float = 600.0
    """Only so long is a place held against a vehicle: one bad first fix must not silence it for a day."""
    speed_slack_m: float = 50.0
    """Clocks tick in seconds, and an origin lies anywhere within a pass."""
    greatest_latitude_deg: float = 85.0
    """Web mercator ends at 85.05 degrees, and no road lies beyond."""


@dataclass(frozen=True, slots=True)
class Times:
    """How clocks and delays are judged."""

    tolerated_skew: timedelta = timedelta(seconds=2)
    """Transport and clock granularity; left as it is."""
    corrected_skew: timedelta = timedelta(minutes=10)
    """A clock without network time drifts this much in months; more is a wrong clock."""
    future: timedelta = timedelta(seconds=5)
    """What remains after correction."""
    oldest: timedelta = timedelta(days=7)
    """A vehicle parked out of coverage over a week's holiday."""
    one_pass: timedelta = timedelta(seconds=600)
    """Evidence of one witness closer than this is one pass: a car does not come round the block sooner."""


@dataclass(frozen=True, slots=True)
class Matching:
    """How a detection finds its obstacle."""

    gate_chi_square: float = 13.815510557964274
    """99.9 % with 2 degrees of freedom: one true pair in a thousand is lost."""
    least_stored_sd_m: float = 0.3
    """Fused positions look better than they are, since GNSS errors of passes correlate."""
    well_known_sd_m: float = 3.0
    """A consumer receiver: what is better known is looked for near a detection only, the few others within the gate of
    the worst pose."""
    shape_weight: float = 6.0
    """An altogether different shape costs as much as 2.4 sd of distance: it decides between neighbours, not alone."""
    joining_overlap: float = 0.5
    """Half of the smaller box inside the other: two pieces of one obstacle."""
    hypotheses: int = 48
    """Common shifts tried for a report; true ones are among the likeliest few."""
    greatest_drift_m: float = 20.0
    """A refined position stays this close to where it was first well known: what many see does not wander off."""
    merging_chi_square: float = 5.991464547107979
    """95 % with 2 degrees of freedom: stricter than the gate, since a merge is not undone."""
    merging_reach_m: float = 50.0
    """Beyond the 95 % of two positions known to 14 m each, which is a bad fix."""
    level_m: float = 4.0
    """A bridge's clearance is at least 4.5 m: further apart in height is another road."""
    level_sd_m: float = 10.0
    """Twice a consumer receiver's vertical sd: beyond it the level is not known."""


@dataclass(frozen=True, slots=True)
class Change:
    """When a size counts as changed. Ratios are larger over smaller, in percent, compared as integers."""

    plan_percent: int = 115
    """The paper's 15 %."""
    relief_percent: int = 125
    """Depth repeats to 5 % with a bias of up to 15 % on small holes: 15 % would be noise."""
    round_elongation: float = 1.2
    """The direction of a nearly round box is noise."""
    heading_sd_rad: float = 0.05
    """A vehicle's heading from its course is good to 1 to 3 degrees, and turns every box it reports."""
    plan_floor_mm: int = 50
    """Below this a LiDAR does not resolve a side."""
    relief_floor_mm: int = 20
    """Two sigma of range noise."""
    at_once_sds: float = 3.0
    """One noisy pass in 370."""
    confirmed_sds: float = 2.0
    """Two passes that agree need less each."""
    overlap_factor: float = 2.0
    """A lost overlap asks for twice the sds: directions have heavier tails than sizes, and holes do not turn."""
    greatest_ln_area_sd: float = 0.12
    """A worse measurement says that the obstacle is there, not how large it is."""
    reference_passes: int = 3
    """Then frozen: folding in every pass would absorb slow growth for ever."""
    equal_views_only: bool = True
    """Boxes seen only from the front are 4 to 9 % smaller."""


@dataclass(frozen=True, slots=True)
class Life:
    """Witnesses, absence and confidence."""

    confirming_witnesses: int = 2
    """One vehicle may be wrong, or lie."""
    confirming_sd_m: float = 10.0
    """A street's width: whoever knows the place worse may have seen another one."""
    removing_witnesses: int = 2
    """One witness must not remove what others saw."""
    removing_witnesses_per_decade: int = 1
    """With a 5 % miss per pass, two misses in a row remove 38 % of real holes after 200 passes, four 0.1 %."""
    least_visible_fraction: float = 0.5
    """At least half of the place was seen."""
    sighting_weight: float = 0.5
    """Half of the remaining doubt goes with a certain sighting: 0.5, 0.75, 0.88."""
    absence_factor: float = 0.5
    """An absence that counts undoes about one sighting."""
    expired_confidence: float = 0.05
    """Below this nobody should be warned."""
    half_life_s: MappingProxyType[Kind, float] = field(default_factory=_half_lives_s)
    """A pothole is mended in about a month, a hump stays, debris is cleared or thrown aside within hours."""
    judged_creations: int = 20
    """A witness is judged by its latest creations that nobody else has seen."""
    refuted_creations: int = 5
    """So many of them found absent by others, and what the witness reports is only logged."""
    kind_hysteresis: int = 2
    """Votes by which another kind must lead, since bump and debris are easily confused."""


@dataclass(frozen=True, slots=True)
class Policy:
    """All numbers of the rule."""

    plausibility: Plausibility = field(default_factory=Plausibility)
    times: Times = field(default_factory=Times)
    matching: Matching = field(default_factory=Matching)
    change: Change = field(default_factory=Change)
    life: Life = field(default_factory=Life)

    @property
    def gate_m(self) -> float:
        """Distance in metres beyond which no detection can match an obstacle, whatever their covariances."""
        pose_m2 = self.plausibility.greatest_pose_sd_m**2
        centre_m2 = self.plausibility.greatest_centre_sd_m**2
        return math.sqrt(self.matching.gate_chi_square * 2 * (pose_m2 + centre_m2))


COOPERATION = Policy()

PAPER = Policy(
    change=Change(
        heading_sd_rad=0.0,
        plan_floor_mm=0,
        relief_floor_mm=0,
        at_once_sds=0.0,
        greatest_ln_area_sd=math.inf,
        reference_passes=1,
        equal_views_only=False,
    ),
    life=Life(confirming_witnesses=1, removing_witnesses=1, removing_witnesses_per_decade=0),
)
"""The paper's section on storage and communication: ratios as printed, one witness, one absence."""


def policy_named(name: PolicyName) -> Policy:
    """The policy of that name."""
    return COOPERATION if name == "cooperation" else PAPER
