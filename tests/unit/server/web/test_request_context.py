"""Names of requests and traces."""

from __future__ import annotations

import string

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from server.web.request_context import RequestNames

TRACE, SPAN = "ab" * 16, "cd" * 8
SANE = frozenset(string.ascii_letters + string.digits + "._:-")


def test_every_request_has_a_name_of_its_own() -> None:
    names, others = RequestNames(), RequestNames()
    made = {source.context([]).request_id for source in (names, others) for _ in range(100)}
    assert len(made) == 200


@given(st.binary(max_size=100))
@example(b"req-7")
@example(b'x"\r\nSet-Cookie: a=b')
def test_a_given_name_is_taken_only_if_a_log_can_hold_it(value: bytes) -> None:
    name = RequestNames().context([(b"x-request-id", value)]).request_id
    assert 1 <= len(name) <= 64
    assert set(name) <= SANE
    is_sane = 1 <= len(value) <= 64 and set(value.decode("latin-1")) <= SANE
    assert (name == value.decode("latin-1")) is is_sane


def test_a_trace_is_continued_under_a_place_of_our_own() -> None:
    context = RequestNames().context([(b"traceparent", f"00-{TRACE}-{SPAN}-01".encode())])
    assert (context.trace_id, context.request_id) == (TRACE, TRACE)
    assert context.traceparent is not None
    version, trace, span, flags = context.traceparent.split("-")
    assert (version, trace, flags, len(span)) == ("00", TRACE, "01", 16)
    assert span != SPAN


def test_a_given_name_wins_over_the_trace() -> None:
    headers = [(b"traceparent", f"00-{TRACE}-{SPAN}-00".encode()), (b"x-request-id", b"req-7")]
    context = RequestNames().context(headers)
    assert (context.request_id, context.trace_id) == ("req-7", TRACE)


@pytest.mark.parametrize(
    "faulty",
    [
        "",
        f"ff-{TRACE}-{SPAN}-01",
        f"00-{'0' * 32}-{SPAN}-01",
        f"00-{TRACE}-{'0' * 16}-01",
        f"00-{TRACE.upper()}-{SPAN}-01",
        f"00-{TRACE}-{SPAN}",
        f"00-{TRACE}-{SPAN}-01x",
    ],
)
def test_a_faulty_trace_is_left_out(faulty: str) -> None:
    context = RequestNames().context([(b"traceparent", faulty.encode())])
    assert (context.trace_id, context.traceparent) == (None, None)


def test_what_a_proxy_passes_on_is_known() -> None:
    names = RequestNames()
    assert not names.context([(b"host", b"x")]).is_forwarded
    assert names.context([(b"x-forwarded-for", b"10.0.0.1")]).is_forwarded
    assert names.context([(b"forwarded", b"for=10.0.0.1")]).is_forwarded
