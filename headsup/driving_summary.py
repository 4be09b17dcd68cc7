"""What a drive came to, for people and as JSON."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping

from rich.console import Console
from rich.table import Table

from headsup.driving import Outcome
from vehicle_client.link.server_link import LinkStatus

WAYS = {"push": "heard by push", "polling": "heard by polling", "none": "not heard"}


def as_json(outcome: Outcome) -> str:
    """All counts of a drive."""
    link = outcome.link
    said = {
        "source": outcome.asked.source,
        "dropped": outcome.dropped,
        "stalls": outcome.stalls,
        "skipped": outcome.skipped,
        "link": None
        if link is None
        else {
            "way": link.way,
            "waiting": link.waiting,
            "unwritten": link.unwritten,
            "trouble": link.trouble,
            "fates": dict(link.fates),
            "unreached_s": link.unreached_s,
        },
        **outcome.totals.as_json(),
    }
    return json.dumps(said, indent=1) + "\n"


def show(outcome: Outcome) -> None:
    """Print a drive's counts."""
    table = Table("", "", title=f"Drive along {outcome.asked.source}", show_header=False, title_justify="left")
    for name, value in _lines(outcome):
        table.add_row(name, value)
    Console().print(table)


def _lines(outcome: Outcome) -> Iterator[tuple[str, str]]:
    totals = outcome.totals
    yield "frames", _with(totals.frames, {"dropped": outcome.dropped, "no sweep": totals.unusable})
    if outcome.stalls:
        yield "times that reading was too slow", str(outcome.stalls)
    if outcome.skipped:
        yield "not usable in the source", str(outcome.skipped)
    if totals.faults:
        yield "frames in which the program failed", str(totals.faults)
    if totals.no_road:
        yield "frames that show no road", str(totals.no_road)
    yield "frames with a place", _with(totals.placed, totals.reasons)
    yield "obstacles in single sweeps", str(totals.detections)
    yield "obstacles believed", _with(totals.tracks, {"moving": totals.moving})
    yield "measured after they were passed", _with(totals.measured.total(), totals.measured)
    yield "reports", _with(totals.reports, {"obstacles": totals.reported, **totals.inspected})
    yield "answered", _with(totals.answers.total(), totals.answers)
    if totals.refusals:
        yield "rejected", _with(totals.refusals.total(), totals.refusals)
    yield "obstacles warned of", str(totals.warned)
    p50_ms, p95_ms = (totals.latency.percentile_ms(percent) for percent in (50, 95))
    if outcome.asked.is_realtime and p50_ms is not None and p95_ms is not None:
        yield "sweep to alert", f"{p50_ms:.0f} ms (median), {p95_ms:.0f} ms (95th percentile)"
    if outcome.link is not None:
        yield "server", in_words(outcome.link, outcome.asked.server)
    if outcome.asked.record is not None:
        yield "recording", outcome.recording_stopped or str(outcome.asked.record)


def in_words(link: LinkStatus, server: str | None) -> str:
    """How it went with the server, and what waits."""
    said = link.trouble or WAYS[link.way]
    if link.trouble is None and link.unreached_s is not None:
        said = f"{server} never reached in {link.unreached_s:.0f} s"
    unwritten = min(link.unwritten, link.waiting)
    stored = link.waiting - unwritten
    lost = f"; {unwritten} report(s) are lost: no disk took them" if unwritten else ""
    return f"{said}; {stored} report(s) wait" + (" for the next drive" if stored else "") + lost


def _with(total: int, parts: Mapping[str, int]) -> str:
    named = ", ".join(f"{name} {number}" for name, number in parts.items() if number)
    return f"{total} ({named})" if named else str(total)
