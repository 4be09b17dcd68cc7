"""The served shape of an obstacle: from one pass, from two that confirmed a change, or the mean of many. Pure."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime

from contract.observation import Detection
from server.life.obstacle import Obstacle, Shape, Size


def shape_of(detection: Detection, observed_at: datetime) -> Shape:
    """The shape as one pass measured it."""
    return Shape(
        box=detection.box,
        box_sd=detection.box_sd,
        volume_m3=detection.volume_m3,
        descriptor=detection.descriptor,
        points_cm=detection.points_cm,
        observed_at=observed_at,
    )


def changed(obstacle: Obstacle, detection: Detection, observed_at: datetime, size: Size) -> Obstacle:
    """The next version: box, descriptor and points of this pass, or the mean box of the two passes that confirmed."""
    shape = replace(shape_of(detection, observed_at), box=size.box, box_sd=size.sd)
    return obstacle._replace(version=obstacle.version + 1, shape=shape, references=(size,), pending=None)


def kept(obstacle: Obstacle, references: tuple[Size, ...], pending: Size | None) -> Obstacle:
    """The obstacle with other references and the mean box of the view it is known best from: no new version."""
    best = min(references, key=lambda size: size.sd.ln_area)
    seen = obstacle.shape
    shape = Shape(best.box, best.sd, seen.volume_m3, seen.descriptor, seen.points_cm, seen.observed_at)
    return obstacle._replace(shape=shape, references=references, pending=pending)


def is_better_look(detection: Detection, obstacle: Obstacle) -> bool:
    """Whether it is sharper than the only pass that has seen the obstacle."""
    return obstacle.sightings == 1 and detection.box_sd.ln_area < obstacle.shape.box_sd.ln_area
