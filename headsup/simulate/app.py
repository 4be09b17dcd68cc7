"""The group of commands."""

from __future__ import annotations

import typer

from headsup.simulate.bags_command import bags
from headsup.simulate.dataset_command import dataset
from headsup.simulate.drive_command import drive
from headsup.simulate.pothole_command import pothole
from headsup.simulate.record_carla_command import record_carla
from headsup.simulate.sensors_command import sensors

simulate_app = typer.Typer(
    help="Make data: potholes, streets and drives with exact truth.", no_args_is_help=True, rich_markup_mode=None
)
simulate_app.command("drive")(drive)
simulate_app.command("dataset")(dataset)
simulate_app.command("bags")(bags)
simulate_app.command("pothole")(pothole)
simulate_app.command("sensors")(sensors)
simulate_app.command("carla")(record_carla)
