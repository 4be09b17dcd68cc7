"""The OpenAPI document against the server: whatever it allows is taken, whatever it forbids is refused as it says."""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx
import pytest
import schemathesis
from hypothesis import HealthCheck, Phase, given
from hypothesis import settings as hypothesis_settings
from schemathesis import Case, GenerationMode
from schemathesis.config import SchemathesisConfig

from contract.observation import ObservationBatch
from tests.integration.conftest import OPERATOR_KEY
from tests.integration.processes import ServerProcess, serving_processes
from tests.unit.server.making import HOUR, detection, message

_KEY = {"Authorization": f"Bearer {OPERATOR_KEY}"}
_UNLIMITED = {
    "HEADSUP_BOOTSTRAP_OPERATOR_KEY": OPERATOR_KEY,
    "HEADSUP_OPERATOR_RATE_HZ": "1e6",
    "HEADSUP_REPORT_RATE_HZ": "1e6",
    "HEADSUP_FAILED_KEYS_PER_MINUTE": "1e9",
}
# What a schema cannot say: that an obstacle exists, is live, and is at the revision that `If-Match` names.
_TAKEN = {"positive_data_acceptance": {"expected-statuses": ["2xx", "304", "404", "409", "412"]}}

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._:-]*")


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServerProcess]:
    path: Path = tmp_path_factory.mktemp("described")
    with serving_processes(f"sqlite+aiosqlite:///{path}/headsup.sqlite3", **_UNLIMITED) as (server,):
        yield server


def _obstacle(server: ServerProcess) -> str:
    """The id of an obstacle that the server knows."""
    report = message(detection(), at=datetime.now(UTC) - HOUR)
    body = ObservationBatch(sent_at=datetime.now(UTC), reports=(report,)).model_dump_json()
    headers = _KEY | {"Content-Type": "application/json"}
    answer = httpx.post(f"{server.url}/v1/observations", content=body, headers=headers, trust_env=False)
    return str(answer.json()["results"][0]["detections"][0]["obstacle_id"])


class _Checks:
    """One operation's examples against the server, with every check of schemathesis."""

    def __init__(self, known_id: str) -> None:
        self._known_id = known_id
        self.number = 0
        self.failures: dict[str, str] = {}

    def allowed(self, case: Case) -> None:
        """A request that fits the document, and what a schema cannot say; half of the ids exist."""
        self.number += 1
        case.query = dict(case.query or {})
        _mend_query(case.operation.path, case.query)
        _mend_body(case.body)
        if self.number % 2 and "obstacle_id" in (case.path_parameters or {}):
            case.path_parameters["obstacle_id"] = self._known_id
        self.forbidden(case)

    def forbidden(self, case: Case) -> None:
        """A request that does not fit it."""
        try:
            case.call_and_validate(headers=_KEY)
        except schemathesis.errors.SchemathesisError:
            raise
        except BaseExceptionGroup as group:
            for error in group.exceptions:
                self.failures.setdefault(f"{case.operation.label}: {type(error).__name__}", str(group)[:2_000])


def _mend_query(path: str, query: dict[str, Any]) -> None:
    """What members say of each other: cursors come from links, an area is one, months have their days."""
    query.pop("cursor", None)
    if "datetime" in query:
        since = re.sub(r"-(29|30|31)(?=[Tt])", "-28", query["datetime"].partition("/")[0])
        query["datetime"] = f"{since}/.." if "/" in query["datetime"] else since
    if "bbox" in query:
        query["bbox"] = _upright(query["bbox"])
    if path != "/v1/obstacles":
        return
    if "bbox" in query:
        for name in ("lat", "lon", "radius_m", "heading_deg", "corridor_m"):
            query.pop(name, None)
        return
    query.setdefault("lat", 38.2)
    query.setdefault("lon", 21.7)
    if "corridor_m" in query:
        query.setdefault("heading_deg", 90)


def _upright(bbox: str) -> str:
    """A box whose south lies below its north, and whose bottom lies below its top."""
    parts = bbox.split(",")
    half = len(parts) // 2
    for low in range(1, half):
        parts[low], parts[low + half] = sorted((parts[low], parts[low + half]), key=float)
    return ",".join(parts)


def _mend_body(value: Any) -> None:
    """The longer side is the length, a covariance has no negative eigenvalue, and numbers have the contract's names."""
    if isinstance(value, list):
        for item in value:
            _mend_body(item)
    if not isinstance(value, dict):
        return
    for item in value.values():
        _mend_body(item)
    if {"width_mm", "length_mm"} <= value.keys():
        value["width_mm"], value["length_mm"] = sorted((value["width_mm"], value["length_mm"]))
    if "east_north_m2" in value:
        value["east_north_m2"] = 0.0
    if {"name", "version", "values"} <= value.keys():
        value["values"] = {name: number for name, number in value["values"].items() if _NAME.fullmatch(name)}


def _assert_true_to_its_description(server: ServerProcess, examples: int) -> int:
    config = SchemathesisConfig.from_dict({"checks": _TAKEN})
    schema = schemathesis.openapi.from_url(f"{server.url}/openapi.json", config=config)
    checks = _Checks(_obstacle(server))
    profile = hypothesis_settings(
        max_examples=examples,
        deadline=None,
        database=None,
        derandomize=True,
        suppress_health_check=list(HealthCheck),
        phases=[Phase.generate],
    )
    for found in schema.get_all_operations():
        operation = found.ok()
        for mode, check in ((GenerationMode.POSITIVE, checks.allowed), (GenerationMode.NEGATIVE, checks.forbidden)):
            if mode is GenerationMode.NEGATIVE and not _can_be_violated(operation):
                continue
            profile(given(operation.as_strategy(generation_mode=mode))(check))()
    assert not checks.failures, "\n\n".join(f"{name}\n{text}" for name, text in checks.failures.items())
    return checks.number


def _can_be_violated(operation: Any) -> bool:
    return bool(operation.body or operation.query or operation.path_parameters)


def test_every_operation_does_what_the_document_says(server: ServerProcess) -> None:
    assert _assert_true_to_its_description(server, 3) > 0


@pytest.mark.soak
def test_every_operation_does_what_the_document_says_hundreds_of_times(server: ServerProcess) -> None:
    number = _assert_true_to_its_description(server, 60)
    print(f"{number} allowed requests")
