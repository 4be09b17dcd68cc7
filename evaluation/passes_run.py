"""All passes of an evaluation, one after the other: what was measured of every obstacle, and every verdict."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from evaluation.passes_drive import Pass, looks_of_pass, plan_passes
from evaluation.passes_inspections import Verdict, verdicts_of
from evaluation.passes_sizes import RANDOM, SIZED, Measured, measured_of
from evaluation.passes_street import hiding_street, passes_street, random_street
from simulator.world import World

Advance = Callable[[str], None]


@dataclass(slots=True)
class PassRecord:
    """What the passes over all streets gave."""

    measured: list[Measured] = field(default_factory=list)
    verdicts: list[Verdict] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Plan:
    """Streets by seed, sensors by preset, speeds."""

    seeds: tuple[int, ...]
    sensors: tuple[str, ...]
    speeds_kmh: tuple[float, ...]

    def passes(self, seed: int) -> list[Pass]:
        """The passes along the street of that seed."""
        return plan_passes(seed, self.sensors, self.speeds_kmh)

    def hidden_passes(self, seed: int) -> list[Pass]:
        """The passes along the street of that seed where cars hide holes: those in the left lane."""
        return [drive for drive in self.passes(seed) if drive.direction < 0]

    def random_passes(self, seed: int) -> list[Pass]:
        """The passes along the street of that seed with random obstacles: those at the highest speed."""
        return [drive for drive in self.passes(seed) if drive.speed_kmh == max(self.speeds_kmh)]

    @property
    def count(self) -> int:
        """Number of passes."""
        lists = (self.passes, self.random_passes, self.hidden_passes)
        return sum(len(passes(seed)) for passes in lists for seed in self.seeds)


def run(plan: Plan, advance: Advance) -> PassRecord:
    """Drive all passes; `advance` is told what comes next, once a pass."""
    record = PassRecord()
    for seed in plan.seeds:
        world = World(passes_street(seed))
        for drive in plan.passes(seed):
            advance(f"street {seed}, {drive.sensor}, {drive.speed_kmh:.0f} km/h")
            for look in looks_of_pass(world, drive):
                record.measured.extend(measured_of(look, SIZED))
                record.verdicts.extend(verdicts_of(world, look))
        various = World(random_street(seed))
        for drive in plan.random_passes(seed):
            advance(f"street {seed} with random obstacles, {drive.sensor}, {drive.speed_kmh:.0f} km/h")
            for look in looks_of_pass(various, drive):
                record.measured.extend(measured_of(look, RANDOM))
        hiding = World(hiding_street(seed))
        for drive in plan.hidden_passes(seed):
            advance(f"street {seed} with parked cars, {drive.sensor}, {drive.speed_kmh:.0f} km/h")
            for look in looks_of_pass(hiding, drive):
                record.verdicts.extend(verdicts_of(hiding, look))
    return record
