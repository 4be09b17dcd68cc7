"""What the end of a drive says of its reports and of the server."""

from __future__ import annotations

from collections import Counter

import pytest

from headsup.driving import Asked, Outcome
from headsup.driving_summary import in_words, show
from vehicle_client.link.server_link import LinkStatus
from vehicle_client.totals import Totals

SERVER = "https://hazards.example"


def test_reports_that_no_disk_took_do_not_wait_for_the_next_drive() -> None:
    said = in_words(LinkStatus("none", 7, 5, "out/outbox.sqlite3: Read-only file system", {}, None), SERVER)
    assert "2 report(s) wait for the next drive" in said
    assert "5 report(s) are lost" in said


@pytest.mark.parametrize(
    ("way", "waiting", "trouble", "unreached_s", "said"),
    [
        ("push", 0, None, None, "heard by push; 0 report(s) wait"),
        ("none", 0, None, None, "not heard; 0 report(s) wait"),
        ("none", 3, None, 41.7, f"{SERVER} never reached in 42 s; 3 report(s) wait for the next drive"),
        ("none", 3, "401: the key is unknown", None, "401: the key is unknown; 3 report(s) wait for the next drive"),
        ("none", 3, "no space left on device", 41.7, "no space left on device; 3 report(s) wait for the next drive"),
    ],
)
def test_the_server_s_line_says_what_is_wrong_and_what_waits(
    way: str, waiting: int, trouble: str | None, unreached_s: float | None, said: str
) -> None:
    assert in_words(LinkStatus(way, waiting, 0, trouble, {}, unreached_s), SERVER) == said


def summary(totals: Totals, capsys: pytest.CaptureFixture[str]) -> dict[str, str]:
    show(Outcome(Asked(source="bag"), totals, skipped=0, dropped=0, stalls=0, link=None, recording_stopped=None))
    rows = (line.split("│") for line in capsys.readouterr().out.splitlines() if "│" in line)
    return {name.strip(): value.strip() for _, name, value, _ in rows}


def test_a_drive_says_why_its_reports_were_rejected(capsys: pytest.CaptureFixture[str]) -> None:
    answers = Counter(rejected=8, accepted=1)
    said = summary(Totals(answers=answers, refusals=Counter({"too-old": 7, "withheld": 1})), capsys)
    assert said["answered"] == "9 (rejected 8, accepted 1)"
    assert said["rejected"] == "8 (too-old 7, withheld 1)"


def test_a_drive_whose_reports_were_all_taken_speaks_of_no_rejection(capsys: pytest.CaptureFixture[str]) -> None:
    assert "rejected" not in summary(Totals(answers=Counter(accepted=5)), capsys)
