"""The outbox: what the car wants to say survives everything until the server has answered it."""

from __future__ import annotations

import resource
import shutil
import sqlite3
import stat
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from datetime import timedelta
from pathlib import Path
from uuid import UUID

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from contract.observation import MAX_REPORTS, ObservationReport
from tests.unit.server.making import NOON, detection, message
from tests.unit.vehicle_client.outbox_making import answered, ids, look, reports, waiting_in
from vehicle_client.link.outbox import BATCH_BYTES, DROPPED_KEPT, Outbox, OutboxError


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "outbox.sqlite3"


@pytest.fixture
def outbox(path: Path) -> Iterator[Outbox]:
    with closing(Outbox(path)) as outbox:
        yield outbox


@contextmanager
def reopened(path: Path, most_bytes: int = 1 << 26) -> Iterator[Outbox]:
    with closing(Outbox(path, most_bytes=most_bytes)) as outbox:
        yield outbox


@contextmanager
def failing_disk() -> Iterator[None]:
    """No file of this process can be written to."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@contextmanager
def full_disk(outbox: Outbox) -> Iterator[None]:
    """SQLite is told that there is no room for another page: it fails as it does when the file system is full."""
    database = outbox._file._database
    assert database is not None
    # No less than it has: what it takes must not fit into pages that are half empty.
    database.execute("PRAGMA max_page_count=1")
    try:
        yield
    finally:
        database.execute("PRAGMA max_page_count=1000000")


def rich_reports(count: int, *, first: int = 0) -> list[ObservationReport]:
    points = tuple((n % 100 - 50, n // 100, -n % 30) for n in range(512))
    rich = detection().model_copy(update={"points_cm": points})
    return [message(*[rich] * 10, at=NOON + timedelta(seconds=n), number=n) for n in range(first, first + count)]


def test_what_was_put_is_there_after_reopening_oldest_first(path: Path) -> None:
    sent = reports(5)
    with reopened(path) as outbox:
        for report in reversed(sent):
            outbox.put(report)
    with reopened(path) as outbox:
        kept = outbox.batch()
        assert [ObservationReport.model_validate_json(item.body) for item in kept] == list(reversed(sent))
        outbox.settle(answered(sent[4], sent[0]))
    with reopened(path) as outbox:
        assert waiting_in(outbox) == ids([sent[3], sent[2], sent[1]])


def test_a_report_survives_a_process_that_is_killed_right_after_putting_it(path: Path) -> None:
    report = reports(1)[0]
    program = (
        "import os, sys; from contract.observation import ObservationReport;"
        "from vehicle_client.link.outbox import Outbox;"
        "Outbox(sys.argv[1]).put(ObservationReport.model_validate_json(sys.stdin.read())); os._exit(9)"
    )
    ended = subprocess.run([sys.executable, "-c", program, str(path)], input=report.model_dump_json().encode())
    assert ended.returncode == 9
    with reopened(path) as outbox:
        assert waiting_in(outbox) == [report.report_id]


def test_the_same_report_is_kept_once_and_in_its_place(outbox: Outbox) -> None:
    one, other = reports(2)
    for report in (one, other, one):
        outbox.put(report)
    assert waiting_in(outbox) == ids([one, other])


def test_settling_what_is_not_there_does_nothing(outbox: Outbox) -> None:
    one, other = reports(2)
    outbox.put(one)
    outbox.settle(answered(other))
    assert (waiting_in(outbox), outbox.counts) == ([one.report_id], {})


def test_every_fate_is_counted_over_all_drives(path: Path) -> None:
    sent = reports(6)
    with reopened(path) as outbox:
        for report in sent:
            outbox.put(report)
        outbox.settle(answered(sent[0], sent[1]) + answered(sent[2], status="duplicate"))
    with reopened(path) as outbox:
        outbox.settle(answered(sent[3], status="rejected", reason="too-old") + answered(sent[4]))
        outbox.drop(sent[5].report_id, "422: it does not fit")
        assert outbox.counts == {"accepted": 3, "duplicate": 1, "rejected": 1, "refused": 1}
        assert outbox.waiting == 0
    with closing(sqlite3.connect(path)) as database:
        assert [
            (str(sent[3].report_id), "rejected: too-old"),
            (str(sent[5].report_id), "422: it does not fit"),
        ] == database.execute("SELECT id, reason FROM dropped ORDER BY position").fetchall()


def test_dropped_reports_are_kept_for_a_look_and_not_without_end(path: Path) -> None:
    with reopened(path) as outbox:
        for report in reports(DROPPED_KEPT + 5):
            outbox.put(report)
            outbox.drop(report.report_id, "422")
        assert outbox.counts == {"refused": DROPPED_KEPT + 5}
        assert len(outbox.take_given_up()) == DROPPED_KEPT + 5
        assert outbox.take_given_up() == []
    with closing(sqlite3.connect(path)) as database:
        assert database.execute("SELECT count(*), min(length(body)) > 100 FROM dropped").fetchall() == [
            (DROPPED_KEPT, 1)
        ]


def test_a_file_that_is_broken_is_moved_aside_and_a_new_one_begun(path: Path) -> None:
    path.write_bytes(b"something else, not a database at all" * 100)
    with reopened(path) as outbox:
        outbox.put(reports(1)[0])
    with reopened(path) as outbox:
        assert outbox.waiting == 1
    (aside,) = path.parent.glob("outbox.sqlite3.broken-*")
    assert aside.read_bytes().startswith(b"something else")


def test_what_can_be_read_of_a_broken_file_is_taken_over(path: Path) -> None:
    sent = reports(60)
    with reopened(path) as outbox:
        for report in sent:
            outbox.put(report)
    with path.open("r+b") as file:
        file.seek(-8192, 2)
        file.write(b"\xa5" * 8192)
    with reopened(path) as outbox:
        kept = waiting_in(outbox)
        outbox.put(reports(1, first=100)[0])
    assert kept == ids(sent)[: len(kept)]
    assert len(kept) > 30


@pytest.fixture(scope="module")
def after_a_kill(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of an outbox of 20 reports whose process was killed: most of it is in SQLite's write-ahead log."""
    folder = tmp_path_factory.mktemp("killed")
    with closing(Outbox(folder / "outbox.sqlite3")) as outbox:
        for report in reports(20):
            outbox.put(report)
        shutil.copytree(folder, folder.with_name("killed-files"))
    return folder.with_name("killed-files")


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    flips=st.lists(st.tuples(st.booleans(), st.floats(0, 1), st.integers(0, 7)), min_size=1, max_size=8),
    cut=st.floats(0, 2),
)
def test_files_that_are_changed_or_cut_anywhere_never_stop_the_car(
    after_a_kill: Path, tmp_path: Path, flips: list[tuple[bool, float, int]], cut: float
) -> None:
    shutil.rmtree(tmp_path)
    shutil.copytree(after_a_kill, tmp_path)
    files = sorted(tmp_path.iterdir())
    contents = [bytearray(file.read_bytes()) for file in files]
    for is_log, place, bit in flips:
        content = contents[-1 if is_log else 0]
        content[int(place * (len(content) - 1))] ^= 1 << bit
    contents[-1] = contents[-1][: int(cut * len(contents[-1]))]
    for file, content in zip(files, contents, strict=True):
        file.write_bytes(content)
    new = reports(3, first=100)
    with reopened(tmp_path / "outbox.sqlite3") as outbox:
        for report in new:
            outbox.put(report)
        assert outbox.trouble is None
        assert set(waiting_in(outbox)) >= set(ids(new))
    with reopened(tmp_path / "outbox.sqlite3") as outbox:
        assert set(waiting_in(outbox)) >= set(ids(new))


def test_a_file_that_breaks_while_it_is_open_costs_no_drive(path: Path) -> None:
    sent = reports(3)
    with reopened(path) as outbox:
        for report in sent:
            outbox.put(report)
        for part in (path, path.with_name(f"{path.name}-wal")):
            part.write_bytes(b"\xa5" * part.stat().st_size)
        outbox.put(reports(1, first=9)[0])
        waiting_in(outbox)
        later = reports(1, first=10)[0]
        outbox.put(later)
        assert waiting_in(outbox)[-1] == later.report_id


def test_two_processes_on_one_file_are_refused_clearly(path: Path) -> None:
    with reopened(path):
        with pytest.raises(OutboxError, match="in use by another process"):
            Outbox(path)
        program = "import sys; from vehicle_client.link.outbox import Outbox; Outbox(sys.argv[1])"
        other = subprocess.run([sys.executable, "-c", program, str(path)], capture_output=True, text=True)
    assert "in use by another process" in other.stderr
    with reopened(path) as outbox:
        assert outbox.trouble is None


def test_a_database_of_another_program_is_refused_and_left_as_it_is(path: Path) -> None:
    with closing(sqlite3.connect(path)) as database:
        database.execute("CREATE TABLE song (title TEXT)")
    before = path.read_bytes()
    with pytest.raises(OutboxError, match="another program"):
        Outbox(path)
    assert path.read_bytes() == before


def test_nobody_but_its_owner_reads_where_the_car_was(path: Path) -> None:
    with reopened(path) as outbox:
        outbox.put(reports(1)[0])
        files = list(path.parent.iterdir())
        assert [stat.S_IMODE(file.stat().st_mode) for file in files] == [0o600] * len(files)


def test_a_folder_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(OutboxError, match="is no folder"):
        Outbox(tmp_path / "nowhere" / "outbox.sqlite3")


def takes_and_gives_without_a_disk(outbox: Outbox, before: list[ObservationReport]) -> list[UUID]:
    during = rich_reports(3, first=10)
    for report in during:
        outbox.put(report)
    assert outbox.trouble is not None
    assert (outbox.waiting, outbox.unwritten) == (5, 3)
    assert waiting_in(outbox) == ids(before + during)
    # Answered while nothing can be written: they must not be sent again and again.
    outbox.settle(answered(before[0], during[0]))
    assert waiting_in(outbox) == ids([before[1], *during[1:]])
    return ids([before[1], *during[1:]])


@pytest.mark.parametrize("is_full", [True, False])
def test_without_a_disk_reports_are_kept_in_memory_and_written_later(path: Path, is_full: bool) -> None:
    before = reports(2)
    with reopened(path) as outbox:
        for report in before:
            outbox.put(report)
        with full_disk(outbox) if is_full else failing_disk():
            left = takes_and_gives_without_a_disk(outbox, before)
        outbox.put(before[1])
        assert waiting_in(outbox) == left
        assert (outbox.trouble, outbox.unwritten) == (None, 0)
        assert outbox.counts == {"accepted": 2}
    with reopened(path) as outbox:
        assert waiting_in(outbox) == left
        assert outbox.counts == {"accepted": 2}


def test_a_full_disk_at_the_start_does_not_keep_the_car_from_driving(path: Path) -> None:
    with failing_disk():
        outbox = Outbox(path)
        outbox.put(reports(1)[0])
        assert (outbox.waiting, outbox.unwritten) == (1, 1)
        assert outbox.trouble is not None
    with closing(outbox):
        assert len(waiting_in(outbox)) == 1
        assert outbox.unwritten == 0


def test_a_full_outbox_gives_up_inspections_first_then_the_oldest(path: Path) -> None:
    seen, looked = reports(4), [look(n) for n in range(20, 24)]
    sizes = [len(report.model_dump_json()) for report in (*seen, *looked)]
    with reopened(path, most_bytes=sum(sizes) - sum(sizes[4:6])) as outbox:
        for report in (*looked[:2], *seen, *looked[2:]):
            outbox.put(report)
        assert waiting_in(outbox) == ids(seen + looked[2:])
        assert [r.report_id for r in outbox.take_given_up()] == ids(looked[:2])
        more = reports(3, first=50)
        for report in more:
            outbox.put(report)
        assert waiting_in(outbox) == ids([*seen[2:], *more])
        assert outbox.counts == {"no-room": 6}
    with reopened(path) as outbox:
        assert waiting_in(outbox) == ids([*seen[2:], *more])


def test_a_batch_holds_what_the_server_takes_and_the_newest_are_not_kept_back(outbox: Outbox) -> None:
    sent = reports(3 * MAX_REPORTS)
    for report in sent:
        outbox.put(report)
    batch = waiting_in(outbox, MAX_REPORTS)
    assert batch == ids(sent[:75] + sent[-25:])
    assert waiting_in(outbox, 1) == ids(sent[:1])
    assert waiting_in(outbox, 4) == ids([*sent[:3], sent[-1]])


def test_a_batch_never_exceeds_the_server_s_limit_however_rich_its_reports(outbox: Outbox) -> None:
    sent = rich_reports(40)
    for report in sent:
        outbox.put(report)
    seen: list[UUID] = []
    while batch := outbox.batch():
        assert BATCH_BYTES / 2 < sum(len(kept.body) + 1 for kept in batch) <= BATCH_BYTES or len(batch) < 10
        seen += [kept.report_id for kept in batch]
        outbox.settle(answered(*[report for report in sent if report.report_id in seen]))
    assert sorted(seen) == sorted(ids(sent))


def test_some_reports_may_be_left_out_or_asked_for(outbox: Outbox) -> None:
    sent = reports(4)
    for report in sent:
        outbox.put(report)
    assert [k.report_id for k in outbox.batch(only=ids(sent[1:3]))] == ids(sent[1:3])
    assert [k.report_id for k in outbox.batch(without=ids(sent[1:3]))] == ids([sent[0], sent[3]])
