"""What an answer to `POST /v1/observations` means for the reports that were sent: one pure table.

`docs/vehicle-server.md` has it as a table. The rule behind it: a report leaves the car's outbox only for an answer of
this contract about this report. What a proxy, a hotel's login page or a server of another version says keeps it there.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from datetime import datetime
from http import HTTPStatus
from uuid import UUID

from pydantic import ValidationError

from contract.observation import ObservationBatchResult, ReportResult, ReportStatus
from vehicle_client.link.back_off import retry_after_s
from vehicle_client.link.http_asking import KEY_NEEDED

PROBLEM = "urn:headsup:problem:"
"""What the `type` of the server's own problems begins with."""

TOO_SLOW = HTTPStatus.REQUEST_TIMEOUT
CLOCK_SKEW = "clock-skew"


@dataclass(frozen=True, slots=True)
class Settle:
    """The server has answered these reports for good; the others of the batch are to be sent again."""

    results: tuple[ReportResult, ...]


@dataclass(frozen=True, slots=True)
class Retry:
    """Nothing was decided: send the same again, not before `after_s` when the server says so, `fewer` at once."""

    reason: str
    after_s: float | None = None
    fewer: bool = False


@dataclass(frozen=True, slots=True)
class Halve:
    """Something in the batch is not taken: send half, until what is not taken stands alone."""

    reason: str


@dataclass(frozen=True, slots=True)
class SetAside:
    """The server fails on this one report: others first, and this one again later."""

    reason: str


@dataclass(frozen=True, slots=True)
class Drop:
    """This one report will never be taken."""

    reason: str


@dataclass(frozen=True, slots=True)
class Stop:
    """No report of this vehicle is taken before somebody has done something: keep all, and ask again rarely."""

    reason: str


Verdict = Settle | Retry | Halve | SetAside | Drop | Stop


def verdict(status: int, headers: Mapping[str, str], content: bytes, sent: Collection[UUID], now: datetime) -> Verdict:
    """What the answer means for the reports `sent`; `headers` are looked up in lower case."""
    alone = len(sent) == 1
    said = f"{status}: {_detail(status, content)}"
    problem = _problem(content)
    match status:
        case HTTPStatus.OK:
            return _results(content, sent)
        case HTTPStatus.BAD_REQUEST | HTTPStatus.UNPROCESSABLE_ENTITY if problem is not None:
            return Drop(said) if alone else Halve(said)
        case HTTPStatus.REQUEST_ENTITY_TOO_LARGE:
            return Drop(said) if alone else Halve(said)
        case HTTPStatus.INTERNAL_SERVER_ERROR if problem is not None:
            return SetAside(said) if alone else Halve(said)
        case HTTPStatus.REQUEST_TIMEOUT | HTTPStatus.TOO_EARLY | HTTPStatus.TOO_MANY_REQUESTS:
            return Retry(said, retry_after_s(headers.get("retry-after"), now), fewer=status == TOO_SLOW)
        case _ if status >= HTTPStatus.INTERNAL_SERVER_ERROR:
            return Retry(said, retry_after_s(headers.get("retry-after"), now))
        case HTTPStatus.UNAUTHORIZED | HTTPStatus.FORBIDDEN if problem is not None:
            return Stop(f"{said}; {KEY_NEEDED}")
        case _:
            return Stop(said)


def _results(content: bytes, sent: Collection[UUID]) -> Verdict:
    try:
        results = ObservationBatchResult.model_validate_json(content).results
    except ValidationError:
        return Stop("200 with an answer that is not of this contract: is this the server, and of the same version?")
    ours = {result.report_id: result for result in results if result.report_id in sent}
    if any(result.status is ReportStatus.REJECTED and result.reason == CLOCK_SKEW for result in ours.values()):
        # It is the moment of sending that was not believed: the reports themselves may be right.
        return Stop("the clocks of vehicle and server are more than 10 minutes apart")
    settled = tuple(result for result in ours.values() if result.status is not ReportStatus.RETRY)
    return Settle(settled) if settled else Retry("200: no report was taken in time")


def _problem(content: bytes) -> str | None:
    """The type of a problem of our server's own; None of anybody else's answer."""
    kind = _members(content).get("type")
    return kind.removeprefix(PROBLEM) if isinstance(kind, str) and kind.startswith(PROBLEM) else None


def _detail(status: int, content: bytes) -> str:
    members = _members(content)
    said = members.get("detail") or members.get("title")
    if said is not None:
        return str(said)[:500]
    return next((known.phrase for known in HTTPStatus if known == status), "no known status")


def _members(content: bytes) -> dict[str, object]:
    try:
        value = json.loads(content)
    except (ValueError, RecursionError):
        return {}
    return value if isinstance(value, dict) else {}
