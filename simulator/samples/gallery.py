"""Twenty-four sorts of obstacles, each as damage and loads look on real roads: a picture sheet, or a mixed data set."""

from __future__ import annotations

from dataclasses import replace

from simulator.samples.sample import Sample, SampleKind, Wishes, make_sample
from simulator.shapes.debris import DebrisKind
from simulator.shapes.hump import HumpProfile

_HOLE, _BUMP, _HUMP, _DEBRIS = SampleKind.POTHOLE, SampleKind.BUMP, SampleKind.HUMP, SampleKind.DEBRIS

_ROAD_M, _LANE_M = 6.4, 3.4
"""Widths of humps across a road 7 m wide, and across one lane."""

GALLERY: tuple[tuple[str, SampleKind, Wishes], ...] = (
    ("small pothole", _HOLE, Wishes(0.30, 0.25, 0.045, 0.04, lobes=1, water=0.0)),
    ("pothole", _HOLE, Wishes(0.75, 0.60, 0.08, 0.08, lobes=1, water=0.0)),
    ("large pothole", _HOLE, Wishes(1.40, 1.00, 0.13, 0.12, lobes=1, water=0.0)),
    ("two lobes", _HOLE, Wishes(1.20, 0.65, 0.09, 0.07, lobes=2, water=0.0)),
    ("three lobes", _HOLE, Wishes(1.60, 0.80, 0.10, 0.07, lobes=3, water=0.0)),
    ("steep edges", _HOLE, Wishes(0.60, 0.50, 0.10, 0.03, lobes=1, water=0.0)),
    ("water inside", _HOLE, Wishes(0.90, 0.70, 0.10, 0.09, lobes=1, water=0.5)),
    ("full of water", _HOLE, Wishes(1.30, 0.80, 0.09, 0.10, lobes=2, water=0.9)),
    ("grown by 60 %", _HOLE, Wishes(0.75, 0.60, 0.08, 0.08, lobes=1, water=0.0, grow_percent=60.0)),
    ("filled with gravel", _HOLE, Wishes(0.95, 0.75, 0.10, 0.08, lobes=1, water=0.0, fill=0.6)),
    ("repaired", _HOLE, Wishes(1.00, 0.75, 0.08, 0.08, lobes=1, water=0.0, repaired=True)),
    ("bump", _BUMP, Wishes(0.90, 0.60, 0.08)),
    ("sinusoidal hump", _HUMP, Wishes(width_m=_ROAD_M, profile=HumpProfile.SINUSOIDAL)),
    ("round-top hump", _HUMP, Wishes(width_m=_LANE_M, profile=HumpProfile.ROUND_TOP)),
    ("flat-top hump", _HUMP, Wishes(5.0, _ROAD_M, profile=HumpProfile.FLAT_TOP)),
    *((str(kind), _DEBRIS, Wishes(shape=kind)) for kind in DebrisKind),
)


def gallery_sample(index: int, seed: int) -> Sample:
    """The sample of a place in the gallery, which begins anew after its end."""
    title, kind, wishes = GALLERY[index % len(GALLERY)]
    return replace(make_sample(kind, seed + index, wishes), name=gallery_name(index, seed), title=title)


def gallery_name(index: int, seed: int) -> str:
    """What `gallery_sample` calls it."""
    title = GALLERY[index % len(GALLERY)][0].removesuffix(" %").replace(" ", "-")
    return f"{title}-{seed + index:04d}"
