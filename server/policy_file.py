"""The policy in force: one of the two of `server.life.policy`, with numbers that a TOML file sets otherwise.

The file has the sections of `Policy`; durations are in seconds, under their name with `_s`. What is unknown, of
another type, or out of bounds is refused.
"""

from __future__ import annotations

import ast
import inspect
import itertools
import math
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from datetime import timedelta
from types import MappingProxyType
from typing import Any

from contract.geometry import Kind
from server.errors import ServiceError
from server.life import policy as policy_module
from server.life.policy import Policy, policy_named
from server.settings import PolicySettings

# A century: ten of them, as many half-lives as the surest obstacle may last, are still moments of the calendar.
_LONGEST_S = 3_155_760_000.0
# Numbers whose bounds are tighter than "not negative"; the drift is what the history of an obstacle looks through.
_BOUNDS: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "least_confidence": (0.0, 1.0),
        "greatest_latitude_deg": (0.0, 85.05),
        "joining_overlap": (0.0, 1.0),
        "greatest_drift_m": (1.0, 40.0),
        "hypotheses": (1, 10_000),
        "plan_percent": (100, 10_000),
        "relief_percent": (100, 10_000),
        "round_elongation": (1.0, 100.0),
        "reference_passes": (1, 1_000),
        "confirming_witnesses": (1, 1_000),
        "removing_witnesses": (1, 1_000),
        "least_visible_fraction": (0.0, 1.0),
        "sighting_weight": (0.0, 1.0),
        "absence_factor": (0.0, 1.0),
        "expired_confidence": (0.001, 0.999),
        "judged_creations": (1, 10_000),
        "refuted_creations": (1, 10_000),
    }
)
_ORDERED = (("least_side_mm", "greatest_side_mm"), ("least_relief_mm", "greatest_relief_mm"))
_MAY_BE_INFINITE = frozenset({"greatest_ln_area_sd"})


class PolicyFileError(ServiceError):
    """The policy file cannot be used; the text says where and why."""


def policy_of(settings: PolicySettings) -> Policy:
    """The policy that the settings name, with the numbers of their file."""
    policy = policy_named(settings.policy)
    if settings.policy_file is None:
        return policy
    try:
        content = tomllib.loads(settings.policy_file.read_text())
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise PolicyFileError(f"{settings.policy_file}: {_in_short(error)}") from None
    try:
        return overridden(policy, content)
    except PolicyFileError as error:
        raise PolicyFileError(f"{settings.policy_file}: {error}") from None


def overridden(policy: Policy, content: Mapping[str, Any]) -> Policy:
    """A policy with the numbers of a parsed file. Raises `PolicyFileError`."""
    sections = {field.name: getattr(policy, field.name) for field in fields(policy)}
    for name, values in content.items():
        if name not in sections or not isinstance(values, dict):
            raise PolicyFileError(f"{name!r} is no section: use {', '.join(sections)}")
        sections[name] = _section(name, sections[name], values)
    return Policy(**sections)


def as_toml(policy: Policy) -> str:
    """A policy as a file that `overridden` takes, each number under its reason."""
    lines: list[str] = []
    for section in fields(policy):
        value = getattr(policy, section.name)
        reasons = _reasons(type(value).__name__)
        lines += ["", f"[{section.name}]"]
        for field in fields(value):
            key, number = _written(field.name, getattr(value, field.name))
            lines += [*(f"# {line.strip()}" for line in reasons[field.name].splitlines()), f"{key} = {number}"]
    return "\n".join(lines[1:]) + "\n"


def _section(section: str, values: Any, given: Mapping[str, Any]) -> Any:
    known = {_key(field.name, getattr(values, field.name)): field.name for field in fields(values)}
    changes: dict[str, Any] = {}
    for key, value in given.items():
        if key not in known:
            raise PolicyFileError(f"{section}.{key} is unknown: `headsup policy show` lists what there is")
        name = known[key]
        changes[name] = _taken(f"{section}.{key}", name, value, getattr(values, name))
    changed = replace(values, **changes)
    for least, greatest in _ORDERED:
        if hasattr(changed, least) and getattr(changed, least) > getattr(changed, greatest):
            raise PolicyFileError(f"{section}.{least} is above {section}.{greatest}")
    return changed


def _taken(place: str, name: str, value: Any, before: Any) -> Any:
    """A value of the file as the field's type."""
    if isinstance(before, MappingProxyType):
        return _half_lives(place, value, before)
    if isinstance(before, bool):
        if not isinstance(value, bool):
            raise PolicyFileError(f"{place} must be true or false")
        return value
    whole = isinstance(before, int)
    number = _number(place, name, value, whole)
    if isinstance(before, timedelta):
        if number > _LONGEST_S:
            raise PolicyFileError(f"{place} is too long: at most {_LONGEST_S:g} s")
        return timedelta(seconds=number)
    return int(number) if whole else number


def _number(place: str, name: str, value: Any, whole: bool) -> float:
    if isinstance(value, bool) or not isinstance(value, int if whole else (int, float)):
        raise PolicyFileError(f"{place} must be a {'whole ' if whole else ''}number")
    low, high = _BOUNDS.get(name, (0.0, math.inf))
    is_infinite = isinstance(value, float) and not math.isfinite(value)
    if (is_infinite and not (value == math.inf and name in _MAY_BE_INFINITE)) or not low <= value <= high:
        upper = "" if math.isinf(high) else f" and at most {high:g}"
        raise PolicyFileError(f"{place} must be at least {low:g}{upper}")
    return value


def _half_lives(place: str, value: Any, before: Mapping[Kind, float]) -> Mapping[Kind, float]:
    kinds = {kind.value: kind for kind in before}
    if not isinstance(value, dict) or not value.keys() <= kinds.keys():
        raise PolicyFileError(f"{place} must have numbers for some of {', '.join(kinds)}")
    given = {kinds[name]: float(_number(f"{place}.{name}", "", number, False)) for name, number in value.items()}
    if not all(1 <= number <= _LONGEST_S for number in given.values()):
        raise PolicyFileError(f"{place} must be at least 1 s and at most {_LONGEST_S:g} s")
    return MappingProxyType({**before, **given})


def _key(name: str, value: Any) -> str:
    return f"{name}_s" if isinstance(value, timedelta) else name


def _written(name: str, value: Any) -> tuple[str, str]:
    if isinstance(value, MappingProxyType):
        return name, "{ " + ", ".join(f"{kind.value} = {number!r}" for kind, number in value.items()) + " }"
    if isinstance(value, timedelta):
        return _key(name, value), repr(value.total_seconds())
    return name, str(value).lower() if isinstance(value, bool) else repr(value)


def _reasons(class_name: str) -> dict[str, str]:
    """The text under each field of a class of `server.life.policy`, which Python itself does not keep."""
    return dict(_documented(inspect.getsource(getattr(policy_module, class_name))))


def _documented(source: str) -> Iterator[tuple[str, str]]:
    (definition,) = ast.parse(source).body
    assert isinstance(definition, ast.ClassDef)  # noqa: S101  # asked for by the name of a class
    body = definition.body
    for field, reason in itertools.pairwise(body):
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and isinstance(reason, ast.Expr):
            assert isinstance(reason.value, ast.Constant)  # noqa: S101  # a bare expression there is the docstring
            yield field.target.id, str(reason.value.value)


def _in_short(error: Exception) -> str:
    return str(error.strerror) if isinstance(error, OSError) else str(error)
