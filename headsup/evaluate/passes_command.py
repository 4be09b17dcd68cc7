"""`headsup evaluate passes`: boxes, descriptors and inspections of single passes against the simulator's truth."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from headsup.evaluate.outputs import make_ready

if TYPE_CHECKING:
    from rich.table import Table

    from evaluation.passes_run import PassRecord, Plan

Record = dict[str, Any]


def passes(
    json_file: Annotated[Path | None, typer.Option("--json", help="Write every table to this file.")] = None,
    pictures: Annotated[Path | None, typer.Option("--pictures", help="Folder for PNG files; made if missing.")] = None,
    seeds: Annotated[
        str, typer.Option("--seeds", help="Streets, by seeds with commas; 1,2,3 were used for tuning.")
    ] = "101,102",
    sensors: Annotated[str, typer.Option("--sensors", help="Presets with commas: hdl64, paper, carla.")] = (
        "hdl64,paper,carla"
    ),
    speeds: Annotated[str, typer.Option("--speeds", help="Speeds in km/h with commas.")] = "30,50",
    quick: Annotated[bool, typer.Option("--quick", help="One street, the paper's sensor, one speed.")] = False,
) -> None:
    """Drive past obstacles of exactly known size, and compare what each pass says with the truth.

    On each street a car passes nine holes of three sizes, bumps and debris at 30 and 50 km/h, in both directions, with
    1 cm and 0.1 degrees of pose noise per sweep; on a second one cars hide holes. Prints how right the sizes are, how
    honest their standard deviations, how well boxes repeat, whether descriptors know an obstacle again, and what
    inspections of known places say. Takes about ten minutes a street with all sensors.

    Examples:

        headsup evaluate passes --quick

        headsup evaluate passes --json passes.json --pictures out/passes

        headsup evaluate passes --seeds 201,202 --sensors hdl64 --speeds 50
    """
    from rich.console import Console

    from evaluation.passes_tables import tables

    plan = _plan(seeds, sensors, speeds, quick=quick)
    try:
        if pictures is not None:
            pictures.mkdir(parents=True, exist_ok=True)
        make_ready(json_file)
        figures = tables(_drive(plan))
        if json_file is not None:
            json_file.write_text(json.dumps({**asdict(plan), **figures}, indent=1) + "\n")
        if pictures is not None:
            _draw(pictures, figures)
    except OSError as error:
        _refuse(f"{error.filename}: {error.strerror}")
    console = Console(width=150)
    for name, records in figures.items():
        console.print(_table(name, records))


def _plan(seeds: str, sensors: str, speeds: str, *, quick: bool) -> Plan:
    from evaluation.passes_drive import SENSORS
    from evaluation.passes_run import Plan

    try:
        numbers = tuple(int(seed) for seed in seeds.split(","))
        kmh = tuple(float(speed) for speed in speeds.split(","))
    except ValueError:
        _refuse("--seeds are whole numbers, --speeds numbers, both with commas, such as 101,102")
    names = tuple(sensors.split(","))
    unknown = [name for name in names if name not in SENSORS]
    if unknown:
        _refuse(f"--sensors {unknown[0]}: known are {', '.join(SENSORS)}")
    if min(numbers) < 0 or not all(5.0 <= speed <= 130.0 for speed in kmh):
        _refuse("--seeds are not negative, --speeds from 5 to 130 km/h")
    return Plan(numbers[:1], ("paper",), kmh[-1:]) if quick else Plan(numbers, names, kmh)


def _drive(plan: Plan) -> PassRecord:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    from evaluation.passes_run import run

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("driving", total=plan.count)

        def advance(what: str) -> None:
            progress.update(task, description=what, advance=1)

        return run(plan, advance)


def _draw(folder: Path, figures: dict[str, list[Record]]) -> None:
    from evaluation.passes_pictures import draw_repeatability

    draw_repeatability(folder / "repeatability.png", figures["repeatability"])


def _table(name: str, records: list[Record]) -> Table:
    from rich.table import Table

    columns = list(dict.fromkeys(key for record in records for key in record))
    table = Table(*(column.replace("_", " ") for column in columns), title=name)
    for record in records:
        table.add_row(*(_text(record.get(column)) for column in columns))
    return table


def _text(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.2f}" if abs(value) < 10 else f"{value:.1f}"
    return "" if value is None else str(value)


def _refuse(message: str) -> NoReturn:
    typer.echo(f"headsup evaluate passes: {message}", err=True)
    raise typer.Exit(1)
