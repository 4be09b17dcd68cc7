"""The table of answers: what each of them means for the reports that were sent."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from uuid import UUID

import pytest
from hypothesis import given
from hypothesis import strategies as st

from contract.observation import ObservationBatchResult, ReportResult, ReportStatus
from vehicle_client.link.verdict import Drop, Halve, Retry, SetAside, Settle, Stop, Verdict, verdict

NOW = datetime(2026, 6, 1, 12, tzinfo=UTC)
ONE, TWO = [UUID(int=1)], [UUID(int=1), UUID(int=2)]
STATUSES = [*range(100, 600), 999]


def problem(kind: str) -> bytes:
    return json.dumps({"type": f"urn:headsup:problem:{kind}", "detail": f"of {kind}"}).encode()


def results(*pairs: tuple[int, ReportStatus], reason: str | None = None) -> bytes:
    items = tuple(ReportResult(report_id=UUID(int=n), status=status, reason=reason) for n, status in pairs)
    return ObservationBatchResult(results=items).model_dump_json().encode()


def meant(status: int, content: bytes = b"", sent: list[UUID] = ONE, **headers: str) -> Verdict:
    return verdict(status, {name.replace("_", "-"): value for name, value in headers.items()}, content, sent, NOW)


@pytest.mark.parametrize(
    ("status", "kind", "alone", "many"),
    [
        (400, "bad-request", Drop, Halve),
        (422, "invalid", Drop, Halve),
        (413, "body-too-large", Drop, Halve),
        (500, "internal", SetAside, Halve),
        (408, "body-too-slow", Retry, Retry),
        (425, "too-early", Retry, Retry),
        (429, "too-many-requests", Retry, Retry),
        (503, "unavailable", Retry, Retry),
        (503, "shutting-down", Retry, Retry),
        (401, "unauthenticated", Stop, Stop),
        (403, "forbidden", Stop, Stop),
        (404, "not-found", Stop, Stop),
        (405, "method-not-allowed", Stop, Stop),
        (409, "conflict", Stop, Stop),
        (415, "unsupported-media-type", Stop, Stop),
        (431, "headers-too-large", Stop, Stop),
    ],
)
def test_every_problem_of_the_server_has_a_meaning(status: int, kind: str, alone: type, many: type) -> None:
    assert type(meant(status, problem(kind), ONE)) is alone
    assert type(meant(status, problem(kind), TWO)) is many


@pytest.mark.parametrize("content", [b"", b"<html>hello</html>", b'{"type": "about:blank"}', b"[1]", b"\xff\xfe"])
def test_what_another_than_the_server_says_costs_no_report(content: bytes) -> None:
    for status in STATUSES:
        assert isinstance(meant(status, content), Retry | Stop) or status == 413
        assert isinstance(meant(status, content, TWO), Retry | Stop | Halve)


@given(st.sampled_from(STATUSES), st.binary(max_size=200), st.text(max_size=30))
def test_no_answer_at_all_is_an_exception(status: int, content: bytes, wait: str) -> None:
    assert isinstance(meant(status, content, TWO, retry_after=wait), Retry | Stop | Halve)


@pytest.mark.parametrize("status", [408, 425, 429, 500, 502, 503, 504, 511])
def test_the_server_s_wait_is_heeded(status: int) -> None:
    told = meant(status, b"", retry_after="17")
    assert isinstance(told, Retry)
    assert told.after_s == 17


def test_a_body_that_was_too_slow_is_sent_in_smaller_pieces() -> None:
    assert meant(408, problem("body-too-slow")) == Retry("408: of body-too-slow", None, fewer=True)
    told = meant(503)
    assert isinstance(told, Retry)
    assert not told.fewer


@pytest.mark.parametrize("status", ["accepted", "duplicate", "rejected"])
def test_answers_for_good_settle_and_the_rest_stays(status: ReportStatus) -> None:
    told = meant(200, results((1, ReportStatus(status)), (2, ReportStatus.RETRY)), TWO)
    assert isinstance(told, Settle)
    assert [r.report_id.int for r in told.results] == [1]


def test_nothing_but_retries_is_a_retry() -> None:
    assert isinstance(meant(200, results((1, ReportStatus.RETRY), (2, ReportStatus.RETRY)), TWO), Retry)
    assert isinstance(meant(200, results(), TWO), Retry)


def test_an_answer_about_a_report_that_was_not_sent_is_not_heard() -> None:
    told = meant(200, results((7, ReportStatus.ACCEPTED), (1, ReportStatus.ACCEPTED)), ONE)
    assert isinstance(told, Settle)
    assert [r.report_id.int for r in told.results] == [1]


def test_a_wrong_clock_costs_no_report() -> None:
    told = meant(200, results((1, ReportStatus.REJECTED), (2, ReportStatus.REJECTED), reason="clock-skew"), TWO)
    assert isinstance(told, Stop)
    assert "clock" in told.reason


@pytest.mark.parametrize("content", [b"", b"OK", b"{}", b'{"results": [{"report_id": 1}]}', b"\xff"])
def test_a_200_of_another_contract_is_not_taken_for_an_answer(content: bytes) -> None:
    assert isinstance(meant(200, content), Stop)


@pytest.mark.parametrize(("status", "kind"), [(401, "unauthenticated"), (403, "forbidden")])
def test_a_key_that_the_server_does_not_take_is_named_with_what_to_do_and_a_proxys_is_not(
    status: int, kind: str
) -> None:
    told = meant(status, problem(kind))
    assert isinstance(told, Stop)
    assert told.reason.startswith(f"{status}: of {kind}; set HEADSUP_API_KEY to a key ")
    assert told.reason.endswith("`headsup keys create --role vehicle`")
    assert meant(status, b"<html>Welcome</html>") in (Stop("401: Unauthorized"), Stop("403: Forbidden"))


def test_the_reason_says_status_and_detail_in_a_bounded_line() -> None:
    assert meant(409, problem("conflict")) == Stop("409: of conflict")
    assert meant(302) == Stop("302: Found")
    assert meant(999) == Retry("999: no known status")
    long = json.dumps({"title": "x" * 100_000}).encode()
    told = meant(403, long)
    assert isinstance(told, Stop)
    assert len(told.reason) < 600
