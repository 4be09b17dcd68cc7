"""The codes of other systems for our kinds, in one table."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

from contract.geometry import Kind
from contract.obstacle import ObstacleProperties

# A hole a metre deep is a collapse of the road, not wear of its surface.
_SINKHOLE_DEPTH_MM = 1_000
# What no car can straddle: wider than the track of its wheels, or higher than any bumper.
_BIG_SIDE_MM, _BIG_HEIGHT_MM = 1_500, 500


@dataclass(frozen=True, slots=True)
class DenmCause:
    """`causeCode` and `subCauseCode` of a DENM (ETSI TS 102 894-2, `CauseCode`)."""

    cause: int
    sub_cause: int


@dataclass(frozen=True, slots=True)
class Codes:
    """What other systems call a kind.

    `datex_record` and `datex_type` are the class and its enumeration in DATEX II v3 `situation`; `itis` is a code of
    SAE J2540-2; `waze` a subtype of the Waze feed; `fiware` a sub-category of the FIWARE data model Alert.
    """

    denm: DenmCause
    denm_severe: DenmCause
    datex_record: str
    datex_element: str
    datex_type: str
    itis: int
    waze: str
    fiware: str
    text: str


# DENM has no code named pothole: 9 / 0 is hazardous location, surface condition; 10 / 0 an obstacle on the road.
_SURFACE = DenmCause(9, 0)
_POOR_SURFACE = ("NonWeatherRelatedRoadConditions", "nonWeatherRelatedRoadConditionType", "roadSurfaceInPoorCondition")

CODES = MappingProxyType(
    {
        Kind.POTHOLE: Codes(
            _SURFACE, DenmCause(5, 7), *_POOR_SURFACE, 5905, "HAZARD_ON_ROAD_POT_HOLE", "pothole", "pothole"
        ),
        Kind.BUMP: Codes(
            _SURFACE, _SURFACE, *_POOR_SURFACE, 5907, "HAZARD_ON_ROAD", "hazardOnRoad", "bump in the road"
        ),
        Kind.DEBRIS: Codes(
            DenmCause(10, 0),
            DenmCause(10, 4),
            "GeneralObstruction",
            "obstructionType",
            "objectOnTheRoad",
            552,
            "HAZARD_ON_ROAD_OBJECT",
            "hazardOnRoad",
            "object on the road",
        ),
    }
)

ITIS_CLEARED = 5942


def denm_cause(properties: ObstacleProperties) -> DenmCause:
    """The DENM code of an obstacle: a collapse for a very deep hole, a big object for what cannot be straddled."""
    codes, box = CODES[properties.kind], properties.box
    if properties.kind is Kind.POTHOLE:
        is_severe = box.relief_mm >= _SINKHOLE_DEPTH_MM
    else:
        is_severe = box.length_mm >= _BIG_SIDE_MM or box.relief_mm >= _BIG_HEIGHT_MM
    return codes.denm_severe if is_severe else codes.denm


def sentence(properties: ObstacleProperties) -> str:
    """An obstacle in words, for people."""
    box = properties.box
    vertical = "deep" if properties.kind is Kind.POTHOLE else "high"
    return (
        f"{CODES[properties.kind].text}, {box.length_mm / 1000:.2f} m x {box.width_mm / 1000:.2f} m, "
        f"{box.relief_mm / 1000:.2f} m {vertical}"
    )
