"""What every drive can be asked is declared once, and both commands take it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import pytest
import typer
from typer.testing import CliRunner

from headsup.cli import app
from headsup.drive_command import Common, with_common


@pytest.mark.parametrize("command", ["drive", "record"])
def test_both_commands_take_and_explain_every_common_option(command: str) -> None:
    said = " ".join(CliRunner().invoke(app, [command, "--help"]).stdout.split())
    for option in ("--calibration", "--sensor-height", "--rate", "--ego", "--topic", "--start", "--json"):
        assert option in said
    assert "Metres above the road" in said
    assert "default: 10.0" in said


def test_a_command_is_given_the_common_options_in_one_and_its_own_beside_them() -> None:
    given: list[tuple[Common, Path, bool]] = []
    only, runner = typer.Typer(), CliRunner()

    def command(
        common: Common, out: Annotated[Path, typer.Argument()], loud: Annotated[bool, typer.Option("--loud")] = False
    ) -> None:
        """Does nothing."""
        given.append((common, out, loud))

    only.command()(with_common(command))
    asked = ["drive.bag", "out.mcap", "--ego", "2", "--topic", "sweep=/a", "--topic", "image=", "--loud"]
    assert runner.invoke(only, asked).exit_code == 0
    assert given == [(Common("drive.bag", ego=2, topic=["sweep=/a", "image="]), Path("out.mcap"), True)]
    assert given[0][0].asked().topics == ("sweep=/a", "image=")
    assert runner.invoke(only, ["drive.bag", "out.mcap", "--ego", "-1"]).exit_code == 2
