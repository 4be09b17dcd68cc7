"""What is asked of a street that is drawn from a seed."""

from __future__ import annotations

from dataclasses import dataclass

from simulator.shapes.relief import Relief
from simulator.streets.street import Roughness

GENTLEST_RADIUS_M = 300.0


@dataclass(frozen=True, slots=True)
class WorldPlan:
    """What a random street may be like. `roughness` None draws a class; `scans` take the place of drawn potholes."""

    length_m: float = 500.0
    roughness: Roughness | None = None
    tightest_radius_m: float = 50.0
    steepest_grade: float = 0.05
    obstacles_per_100m: float = 3.5
    features_per_100m: float = 6.0
    side_roads: bool = True
    scans: tuple[Relief, ...] = ()

    def __post_init__(self) -> None:
        if not (60.0 <= self.length_m <= 5_000.0 and 30.0 <= self.tightest_radius_m <= GENTLEST_RADIUS_M):
            raise ValueError(f"a street is 60 to 5000 m long, its curves 30 to {GENTLEST_RADIUS_M:.0f} m wide")
        if not (0 <= self.steepest_grade <= 0.15 and 0 <= self.obstacles_per_100m <= 8 and self.features_per_100m >= 0):
            raise ValueError("a street climbs at most by 15 %, and carries at most 8 obstacles in 100 m")
