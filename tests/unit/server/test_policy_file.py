"""Numbers of the policy from a file."""

from __future__ import annotations

import tomllib
from dataclasses import fields
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.geometry import Kind
from server.life.policy import COOPERATION, PAPER, Policy
from server.policy_file import PolicyFileError, as_toml, overridden, policy_of
from server.settings import Settings


@pytest.mark.parametrize("policy", [COOPERATION, PAPER])
def test_what_is_shown_can_be_set(policy: Policy) -> None:
    assert overridden(COOPERATION, tomllib.loads(as_toml(policy))) == policy


def test_every_number_is_shown_under_its_reason() -> None:
    lines = as_toml(COOPERATION).splitlines()
    numbers = [index for index, line in enumerate(lines) if " = " in line and not line.startswith("#")]
    assert len(numbers) == sum(len(fields(getattr(COOPERATION, section.name))) for section in fields(COOPERATION))
    assert all(lines[index - 1].startswith("# ") and len(lines[index - 1]) > 10 for index in numbers)


def test_only_what_is_given_changes() -> None:
    content = {"times": {"oldest_s": 3_600}, "life": {"half_life_s": {"debris": 60}, "confirming_witnesses": 3}}
    policy = overridden(COOPERATION, content)
    assert policy.times.oldest == timedelta(hours=1)
    assert policy.times.future == COOPERATION.times.future
    assert policy.life.confirming_witnesses == 3
    assert policy.life.half_life_s[Kind.DEBRIS] == 60
    assert policy.life.half_life_s[Kind.POTHOLE] == COOPERATION.life.half_life_s[Kind.POTHOLE]
    assert (policy.plausibility, policy.matching, policy.change) == (
        COOPERATION.plausibility,
        COOPERATION.matching,
        COOPERATION.change,
    )


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ({"time": {}}, "is no section"),
        ({"oldest_s": 3}, "is no section"),
        ({"times": {"oldest": 3}}, "times.oldest is unknown"),
        ({"change": {"plan_percent": 99}}, "at least 100"),
        ({"change": {"plan_percent": 115.5}}, "whole number"),
        ({"change": {"plan_percent": True}}, "whole number"),
        ({"change": {"equal_views_only": 1}}, "true or false"),
        ({"change": {"at_once_sds": "3"}}, "must be a number"),
        ({"matching": {"gate_chi_square": float("nan")}}, "at least 0"),
        ({"matching": {"gate_chi_square": float("inf")}}, "at least 0"),
        ({"matching": {"greatest_drift_m": 100}}, "at most 40"),
        ({"life": {"least_visible_fraction": 1.5}}, "at most 1"),
        ({"life": {"half_life_s": {"pothole": 0}}}, "at least 1 s"),
        ({"life": {"half_life_s": {"hole": 60}}}, "pothole, bump, debris"),
        ({"plausibility": {"least_side_mm": 30_000}}, "is above"),
        ({"times": {"oldest_s": 1e300}}, "too long"),
    ],
)
def test_what_makes_no_sense_is_refused_by_name(content: dict[str, Any], told: str) -> None:
    with pytest.raises(PolicyFileError, match=told):
        overridden(COOPERATION, content)


_values = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.just({"pothole": 1})
_keys = st.sampled_from([key for part in tomllib.loads(as_toml(COOPERATION)).values() for key in part])
_sections = st.sampled_from(["plausibility", "times", "matching", "change", "life"])


@given(st.dictionaries(_sections, _values | st.dictionaries(_keys | st.text(max_size=5), _values, max_size=5)))
def test_any_file_is_taken_or_refused(content: dict[str, Any]) -> None:
    try:
        policy = overridden(COOPERATION, content)
    except PolicyFileError:
        return
    assert policy.gate_m >= 0
    assert overridden(COOPERATION, tomllib.loads(as_toml(policy))) == policy


def test_a_file_overrides_the_policy_that_is_named(tmp_path: Path) -> None:
    path = tmp_path / "policy.toml"
    path.write_text("[life]\nconfirming_witnesses = 4\n")
    policy = policy_of(Settings(policy="paper", policy_file=path))
    assert policy.life.confirming_witnesses == 4
    assert policy.change == PAPER.change


@pytest.mark.parametrize("content", [b"[life", b"\xff\xfe", None, b"[life]\nx = 1"])
def test_a_file_that_cannot_be_used_is_named(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "policy.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(PolicyFileError, match=r"policy\.toml: "):
        policy_of(Settings(policy_file=path))
