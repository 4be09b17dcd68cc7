"""The group of commands."""

from __future__ import annotations

import typer

from headsup.evaluate.carved_command import carved
from headsup.evaluate.figures_command import evaluate_figures
from headsup.evaluate.lidar_command import lidar
from headsup.evaluate.passes_command import passes
from headsup.evaluate.pose_command import pose
from headsup.evaluate.real_command import real
from headsup.evaluate.records_command import records
from headsup.evaluate.table1_command import table1
from headsup.evaluate.table2_command import table2
from headsup.evaluate.told_command import told
from headsup.evaluate.volume_command import volume
from headsup.evaluate.warned_command import warned

evaluate_app = typer.Typer(
    help="Make the figures of the tables anew: from real data, and from the simulator's truth.",
    no_args_is_help=True,
    rich_markup_mode=None,
)


@evaluate_app.callback()
def evaluate() -> None:
    """Make the figures of the tables anew: from real data, and from the simulator's truth."""


evaluate_app.command("figures")(evaluate_figures)


evaluate_app.command("table1")(table1)
evaluate_app.command("table2")(table2)
evaluate_app.command("volume")(volume)
evaluate_app.command("passes")(passes)
evaluate_app.command("lidar")(lidar)
evaluate_app.command("carved")(carved)
evaluate_app.command("real")(real)
evaluate_app.command("told")(told)
evaluate_app.command("warned")(warned)
evaluate_app.command("pose")(pose)
evaluate_app.command("records")(records)
