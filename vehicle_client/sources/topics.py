"""Which topic of a recording is the LiDAR, which the forward camera, which the receiver."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from vehicle_client.sources.frame import SourceError
from vehicle_client.sources.readings import Reading

Decode = Callable[[float, bytes], Sequence[Reading]]
"""Log time (Unix seconds) and bytes of a message to what it says; raises `SourceError` where it makes no sense."""


class Role(StrEnum):
    """What a topic is taken for; the names that options use."""

    SWEEP = "sweep"
    IMAGE = "image"
    FIX = "fix"
    IMU = "imu"
    ODOMETRY = "odometry"
    MOTION = "motion"
    VELOCITY = "velocity"


LIKELY: Mapping[Role, tuple[tuple[str, ...], ...]] = {
    Role.SWEEP: (
        ("lidar", "velodyne", "ouster", "hesai", "livox", "rslidar", "points", "scan"),
        ("top", "roof", "front", "center", "middle"),
        ("points_raw", "raw", "full"),
    ),
    Role.IMAGE: (("front", "forward", "center", "middle", "rgb", "color"), ("front", "forward"), ("color",)),
    Role.FIX: (("fix", "gnss", "gps", "navsat"), ("fix",)),
    Role.IMU: (("imu/data", "imu"), ("imu/data",)),
    Role.ODOMETRY: (("odom",), ("wheel", "filtered")),
    Role.MOTION: (("vehicle", "twist", "vel"), ("vehicle", "wheel")),
    Role.VELOCITY: (("fix", "gnss", "gps", "navsat"), ("fix",)),
}
"""Words by which one of several is told, tried in turn: each leaves those that have one of them."""

UNLIKELY: Mapping[Role, tuple[str, ...]] = {
    Role.SWEEP: ("semantic", "filtered", "ground", "map", "cluster", "obstacle", "detection", "label", "radar"),
    Role.IMAGE: ("right", "left", "infra", "thermal"),
    Role.IMU: ("raw", "mag"),
    Role.MOTION: ("cmd",),
}
"""Words of what was made from measurements, or looks elsewhere: taken if there is nothing else."""

NEVER: Mapping[Role, tuple[str, ...]] = {
    Role.IMAGE: ("overlay", "semantic", "segment", "depth", "mask", "rear", "back"),
}
"""Words of what is taken only if it is asked for: a picture that shows another scene is worse than none."""


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic that can be read; `messages` is their number, None where nobody counted."""

    name: str
    type: str
    role: Role
    decode: Decode
    messages: int | None = None


def choose(topics: Sequence[Topic], asked: Mapping[str, str], place: object, others: Iterable[str] = ()) -> list[Topic]:
    """One topic for each role that there is one for; `asked` names some, with an empty name for none at all.

    `SourceError` where there is no LiDAR, a topic asked for is missing, or several cannot be told apart: it lists them.
    """
    for role in asked:
        if role not in set(Role):
            raise SourceError(f"there is no topic called {role} to choose; expected {', '.join(Role)}")
    chosen = []
    for role in Role:
        candidates = [topic for topic in topics if topic.role is role and topic.messages != 0]
        if role in asked:
            found = [topic for topic in candidates if topic.name == asked[role]]
            if asked[role] and not found:
                raise SourceError(f"{place}: no {role} topic {asked[role]}; there are {_listed(candidates)}")
            chosen += found
            continue
        able = [t for t in candidates if not any(word in t.name.lower() for word in NEVER.get(role, ()))]
        if able:
            chosen.append(_likeliest(role, able, place))
    if not any(topic.role is Role.SWEEP for topic in chosen):
        there = ", ".join([*(f"{t.name} ({t.type})" for t in topics), *others]) or "none at all"
        raise SourceError(
            f"{place}: expected point clouds (foxglove.PointCloud or sensor_msgs/PointCloud2); its topics: {there}"
        )
    return chosen


def _likeliest(role: Role, candidates: list[Topic], place: object) -> Topic:
    left = _fewer(candidates, lambda name: not any(word in name for word in UNLIKELY.get(role, ())))
    # image_raw/compressed is the same picture as image_raw.
    names = [topic.name for topic in left]
    left = [t for t in left if not any(t.name.startswith(f"{name}/") for name in names)]
    for words in LIKELY[role]:
        left = _fewer(left, lambda name, words=words: any(word in name for word in words))  # type: ignore[misc]
    if len(left) > 1:
        raise SourceError(f"{place}: several topics could be the {role}: {_listed(left)}; say which")
    return left[0]


def _fewer(topics: list[Topic], wanted: Callable[[str], bool]) -> list[Topic]:
    """Those whose name is wanted, or all if none is."""
    return [topic for topic in topics if wanted(topic.name.lower())] or topics


def _listed(topics: Sequence[Topic]) -> str:
    return ", ".join(topic.name for topic in topics) or "none"
