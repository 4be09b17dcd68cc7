from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest
from numba.core import event
from typer.testing import CliRunner

from headsup import compiling, first_uses
from headsup.cli import app
from headsup.compiling import COMPILING, said_while_compiling

# In a process of its own: here other tests have used the loops.
UNUSED_LOOPS = """
import json, pkgutil, sys
from importlib import import_module
from numba.core.dispatcher import Dispatcher
import detector, vehicle_client
from headsup.first_uses import _see_a_street, _use_the_rest

names = [m.name for of in (detector, vehicle_client) for m in pkgutil.walk_packages(of.__path__, of.__name__ + ".")]
loops = {
    f"{name}.{key}": value
    for name in names
    if not name.endswith("__main__")
    for key, value in vars(import_module(name)).items()
    if isinstance(value, Dispatcher) and value.py_func.__module__ == name
}
# What a loop calls is compiled, and kept, with it.
called = {id(loop.py_func.__globals__.get(name)) for loop in loops.values() for name in loop.py_func.__code__.co_names}
_see_a_street()
_use_the_rest()
unused = [name for name, loop in loops.items() if not loop.signatures and id(loop) not in called]
print(json.dumps([len(loops), unused]))
"""


def test_every_loop_of_detector_and_vehicle_is_compiled_before_the_first_drive() -> None:
    done = subprocess.run([sys.executable, "-c", UNUSED_LOOPS], capture_output=True, text=True, check=True)
    loops, unused = json.loads(done.stdout.splitlines()[-1])
    assert loops > 50
    assert unused == []


def test_without_a_folder_for_compiled_loops_a_command_says_which_setting_names_one() -> None:
    command = [sys.executable, "-m", "headsup.cli", "drive", "nowhere"]
    # As on a read-only disk without a home: this leaves numba nothing but a folder that nobody has named.
    bare = {"NUMBA_CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator"}
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"} | bare
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert "set NUMBA_CACHE_DIR to a folder that can be written" in line


def compile_something(times: int) -> None:
    for _ in range(times):
        with event.trigger_event(COMPILING, data={}):
            pass


def test_long_compiling_is_said_once_and_only_within_the_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(compiling, "SILENT_S", -1.0)
    with said_while_compiling("drive"):
        compile_something(3)
    compile_something(1)
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("headsup drive: compiling for this machine")
    assert said.err.count("\n") == 1


def test_a_moment_s_compiling_is_nothing_to_speak_of(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(compiling, "SILENT_S", 3600.0)
    with said_while_compiling("drive"):
        compile_something(3)
    assert capsys.readouterr().err == ""


def test_the_command_names_what_is_ready(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(first_uses, "compile_all", lambda: iter(["detector", "simulator"]))
    done = CliRunner().invoke(app, ["compile"])
    assert (done.exit_code, done.stdout) == (0, "detector: ready\nsimulator: ready\n")


def test_what_cannot_be_compiled_is_one_line_and_exit_code_1(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails() -> None:
        raise RuntimeError("cannot cache function: no locator available")

    monkeypatch.setattr(first_uses, "compile_all", fails)
    done = CliRunner().invoke(app, ["compile"])
    assert done.exit_code == 1
    assert done.stdout == ""
    assert done.stderr.splitlines()[-1].startswith("headsup compile: cannot cache function")
