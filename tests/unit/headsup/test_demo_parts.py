"""The demo's parts: what they do when something is not as expected."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from headsup.cli import app
from headsup.demo.film import Film
from headsup.demo.problem import DemoError
from headsup.demo.record import true_name
from headsup.demo.server_process import ServerProcess
from headsup.demo.story import GROWTH, acts
from simulator.streets.street import first_light_street


def test_help_loads_nothing_heavy() -> None:
    probe = (
        "import sys; from headsup.cli import app; heavy = {'numpy', 'open3d', 'sqlalchemy', 'fastapi', 'cv2'};"
        " print(sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


@pytest.mark.parametrize("command", [["demo"], ["detect"], ["serve"], ["keys", "create"], ["db", "upgrade"]])
def test_every_command_shows_an_example(command: list[str]) -> None:
    text = " ".join(CliRunner().invoke(app, [*command, "--help"]).output.split())
    assert "Example" in text
    assert "headsup " + " ".join(command) in text


def test_a_server_that_cannot_start_is_named_with_its_log(tmp_path: Path) -> None:
    (tmp_path / "headsup.sqlite3").write_text("this is not a database, and longer than a header of one " * 20)
    log = tmp_path / "server.log"
    with ServerProcess(tmp_path, log) as server, pytest.raises(DemoError, match=str(log)):
        server.start()


def test_a_server_that_dies_is_noticed(tmp_path: Path) -> None:
    with ServerProcess(tmp_path, tmp_path / "server.log") as server:
        server.start()
        server.ensure_alive()
        assert server.url.startswith("http://127.0.0.1:")
        os.kill(server.process_id, signal.SIGKILL)
        os.waitid(os.P_PID, server.process_id, os.WEXITED | os.WNOWAIT)
        with pytest.raises(DemoError, match="signal 9"):
            server.ensure_alive()


def test_the_pothole_grows_by_a_quarter_and_is_then_filled() -> None:
    one, two, three, four, five = acts(first_light_street(1))
    hole = one.street.obstacles[0]
    grown = three.street.obstacle(hole.obstacle_id)
    assert two.street is one.street
    assert grown.shape.footprint_area_m2 / hole.shape.footprint_area_m2 == pytest.approx(GROWTH, rel=0.02)
    assert four.street.obstacle(hole.obstacle_id).filled
    assert five.street is four.street


def test_obstacles_of_one_kind_are_numbered_and_others_are_not() -> None:
    street = first_light_street(1)
    names = [true_name(street, placed.obstacle_id) for placed in street.obstacles]
    assert names == ["pothole 1", "bump", "debris", "pothole 2"]


def test_a_film_that_cannot_be_written_is_an_error_that_names_it(tmp_path: Path) -> None:
    path = tmp_path / "missing" / "film.mp4"

    class Silent:
        def progress(self, name: str, done: int, total: int) -> None: ...

    with Film(path, first_light_street(1), ()) as film, pytest.raises(DemoError, match=r"film\.mp4"):
        film.finish(Silent())
