"""Whether an obstacle's size has changed: ratios in integer millimetres, floors, and the noise of both sizes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from scipy.special import chdtri

from contract.geometry import Box, BoxSd
from contract.observation import Detection
from server.geometry.footprint import elongation, turn_rad, union_over_intersection
from server.life.obstacle import Size
from server.life.policy import Change

# Rounding of polygon areas, far below the 1 part in 10^8 that a millimetre makes in a 10 m box.
_OVERLAP_ROUNDING = 1e-10
# A size reported without any noise still weighs no more than one known to 0.1 %.
_LEAST_SD = 1e-3


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a pass says of the size. `new_size` replaces all when the obstacle changed; otherwise the references do."""

    reason: str
    references: tuple[Size, ...]
    pending: Size | None
    new_size: Size | None = None

    @property
    def changed(self) -> bool:
        """Whether the stored box, descriptor and points are to be replaced."""
        return self.new_size is not None


def measured_size(detection: Detection, policy: Change) -> Size:
    """Size of one pass, under the key of its view."""
    return Size(_view_key(detection, policy), detection.box, detection.box_sd)


def is_comparable(detection: Detection, policy: Change) -> bool:
    """Whether a measurement says how large the obstacle is, and not only that it is there."""
    if policy.equal_views_only and not (detection.view.front or detection.view.rear):
        return False
    return detection.box_sd.ln_area <= policy.greatest_ln_area_sd


def judge(measured: Size, references: tuple[Size, ...], pending: Size | None, policy: Change) -> Verdict:
    """Judge a new pass against the frozen reference of its view (`repeatability`, section "Decision rule")."""
    reference = next((size for size in references if size.view == measured.view), None)
    if reference is None:
        return Verdict("first-in-this-view", (*references, measured), pending)
    # What no noise excuses goes first: within all limits, as nearly always, nothing exceeds them by any noise.
    if not changes(reference, measured, 0.0, policy):
        return Verdict("within-limits", _folded(references, reference, measured, policy), None)
    if at_once := changes(reference, measured, policy.at_once_sds, policy):
        return Verdict(at_once[0], references, None, measured)
    if pending is None or pending.view != measured.view:
        return Verdict("change-unconfirmed", references, measured)
    both = fused(pending, measured)
    if confirmed := changes(reference, both, policy.confirmed_sds, policy):
        return Verdict(f"{confirmed[0]}-confirmed", references, None, both)
    return Verdict("change-unconfirmed", references, measured)


def changes(old: Size, new: Size, sds: float, policy: Change) -> list[str]:
    """Names of the limits that the new size exceeds by more than `sds` combined standard deviations; empty if none."""
    return list(_changes(old, new, sds, policy))


def fused(a: Size, b: Size) -> Size:
    """Inverse-variance mean of two sizes, of sides in logarithms, of directions modulo pi."""
    length_mm, ln_length = _fused_ln(a.box.length_mm, a.sd.ln_length, b.box.length_mm, b.sd.ln_length)
    width_mm, ln_width = _fused_ln(a.box.width_mm, a.sd.ln_width, b.box.width_mm, b.sd.ln_width)
    relief_mm, relief_sd_mm = _fused(a.box.relief_mm, a.sd.relief_mm, b.box.relief_mm, b.sd.relief_mm)
    box = Box(
        length_mm=max(length_mm, width_mm),
        width_mm=min(length_mm, width_mm),
        yaw_rad=_fused_yaw_rad(a, b),
        relief_mm=round(relief_mm),
    )
    _, ln_area = _fused(0.0, a.sd.ln_area, 0.0, b.sd.ln_area)
    sd = BoxSd(ln_length=ln_length, ln_width=ln_width, ln_area=ln_area, relief_mm=relief_sd_mm)
    return Size(a.view, box, sd, a.passes + b.passes)


def _changes(old: Size, new: Size, sds: float, policy: Change) -> Iterator[str]:
    a, b = old.box, new.box
    if _plan_change_mm(a, b, policy) > policy.plan_floor_mm:
        if _beyond(_area_mm2(a), _area_mm2(b), policy.plan_percent) and _significant(
            math.log(_area_mm2(b) / _area_mm2(a)), old.sd.ln_area, new.sd.ln_area, sds
        ):
            yield "area"
        if _beyond(a.length_mm, b.length_mm, policy.plan_percent) and _significant(
            math.log(b.length_mm / a.length_mm), old.sd.ln_length, new.sd.ln_length, sds
        ):
            yield "length"
        if _beyond(a.width_mm, b.width_mm, policy.plan_percent) and _significant(
            math.log(b.width_mm / a.width_mm), old.sd.ln_width, new.sd.ln_width, sds
        ):
            yield "width"
        if _overlap_lost(a, b, policy) and _jointly_significant(old, new, policy.overlap_factor * sds, policy):
            yield "overlap"
    relief_change_mm = b.relief_mm - a.relief_mm
    if (
        abs(relief_change_mm) > policy.relief_floor_mm
        and _beyond(a.relief_mm, b.relief_mm, policy.relief_percent)
        and _significant(relief_change_mm, old.sd.relief_mm, new.sd.relief_mm, sds)
    ):
        yield "relief"


def _beyond(a: int, b: int, percent: int) -> bool:
    """Whether larger / smaller exceeds a percentage, exactly."""
    return 100 * max(a, b) > percent * min(a, b)


def _significant(difference: float, a_sd: float, b_sd: float, sds: float) -> bool:
    return abs(difference) > sds * math.hypot(a_sd, b_sd)


def _overlap_lost(a: Box, b: Box, policy: Change) -> bool:
    inverse = union_over_intersection(a, b, ignore_yaw=_is_round(a, b, policy))
    return 100 * inverse > policy.plan_percent * (1 + _OVERLAP_ROUNDING)


def _jointly_significant(old: Size, new: Size, sds: float, policy: Change) -> bool:
    """Whether length, width and direction together differ by more than noise, at the probability of `sds` sigma."""
    length_sd, width_sd = _combined(old.sd.ln_length, new.sd.ln_length), _combined(old.sd.ln_width, new.sd.ln_width)
    statistic = (math.log(new.box.length_mm / old.box.length_mm) / length_sd) ** 2
    statistic += (math.log(new.box.width_mm / old.box.width_mm) / width_sd) ** 2
    freedoms = 2
    if not _is_round(old.box, new.box, policy):
        yaw_sd_rad = _combined(_yaw_sd_rad(old, policy), _yaw_sd_rad(new, policy))
        statistic += (turn_rad(old.box, new.box) / yaw_sd_rad) ** 2
        freedoms = 3
    return statistic > float(chdtri(freedoms, math.erfc(sds / math.sqrt(2))))


def _yaw_sd_rad(size: Size, policy: Change) -> float:
    """Noise of a moment box's direction: an eigenvector turns by noise over the difference of the eigenvalues.

    The heading of the vehicle adds to it, once for each pass.
    """
    ratio = elongation(size.box)
    side_sd = math.hypot(size.sd.ln_length, size.sd.ln_width) / math.sqrt(2)
    turn_sd_rad = math.sqrt(2) * side_sd * ratio / max(ratio**2 - 1, _LEAST_SD)
    return math.hypot(turn_sd_rad, policy.heading_sd_rad / math.sqrt(size.passes))


def _plan_change_mm(a: Box, b: Box, policy: Change) -> float:
    """The farthest that a side has grown or a corner has moved by turning."""
    sides_mm = max(abs(a.length_mm - b.length_mm), abs(a.width_mm - b.width_mm))
    if _is_round(a, b, policy):
        return sides_mm
    return max(sides_mm, math.hypot(a.length_mm, a.width_mm) / 2 * turn_rad(a, b))


def _is_round(a: Box, b: Box, policy: Change) -> bool:
    return min(elongation(a), elongation(b)) < policy.round_elongation


def _folded(references: tuple[Size, ...], reference: Size, measured: Size, policy: Change) -> tuple[Size, ...]:
    """References with a pass folded into the one of its view, unless that is frozen."""
    if reference.passes >= policy.reference_passes:
        return references
    return tuple(fused(size, measured) if size is reference else size for size in references)


def _fused_ln(a_mm: int, a_sd: float, b_mm: int, b_sd: float) -> tuple[int, float]:
    mean, sd = _fused(math.log(a_mm), a_sd, math.log(b_mm), b_sd)
    return round(math.exp(mean)), sd


def _fused_yaw_rad(a: Size, b: Size) -> float:
    """Mean direction: directions modulo pi are averaged as doubled angles."""
    a_weight, b_weight = (1 / max(size.sd.ln_area, _LEAST_SD) ** 2 for size in (a, b))
    sine = a_weight * math.sin(2 * a.box.yaw_rad) + b_weight * math.sin(2 * b.box.yaw_rad)
    cosine = a_weight * math.cos(2 * a.box.yaw_rad) + b_weight * math.cos(2 * b.box.yaw_rad)
    # The second modulo catches a tiny negative angle, which the first one rounds up to pi.
    return math.atan2(sine, cosine) / 2 % math.pi % math.pi


def _fused(a: float, a_sd: float, b: float, b_sd: float) -> tuple[float, float]:
    a_weight, b_weight = (1 / max(sd, _LEAST_SD) ** 2 for sd in (a_sd, b_sd))
    total = a_weight + b_weight
    return (a_weight * a + b_weight * b) / total, total**-0.5


def _combined(a_sd: float, b_sd: float) -> float:
    return max(math.hypot(a_sd, b_sd), _LEAST_SD)


def _area_mm2(box: Box) -> int:
    return box.length_mm * box.width_mm


def _view_key(detection: Detection, policy: Change) -> str:
    if not policy.equal_views_only:
        return "any"
    seen = [name for name, is_seen in (("front", detection.view.front), ("rear", detection.view.rear)) if is_seen]
    return "+".join(seen) or "none"
