"""`headsup detect`: run the detector on files of single sweeps and write what it found beside a picture."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from detector.types import DetectedObstacle, FrameDetection


class MethodName(StrEnum):
    """How points are judged."""

    SURFACE = "surface"
    SALIENCY = "saliency"


def detect_files(
    files: Annotated[
        list[Path], typer.Argument(help="KITTI .bin, nuScenes .pcd.bin, PLY, PCD, LAS/LAZ, NPY/NPZ clouds.")
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder for the results; made if missing.")],
    method: Annotated[
        MethodName, typer.Option("--method", help="surface: deviation from the road; saliency: the paper's method.")
    ] = MethodName.SURFACE,
    sensor_height: Annotated[
        float | None,
        typer.Option("--sensor-height", min=0.1, max=10.0, help="Metres above the road; estimated when not given."),
    ] = None,
) -> None:
    """Find potholes, bumps and debris in single sweeps.

    For each FILE writes into the folder, under the file's name without its last ending: NAME.labels.npy (a class for
    each point), NAME.saliency.npy, NAME.obstacles.json and NAME.png. Files of equal name in different folders are told
    apart by the folder's name. A file that cannot be used is reported, and the others go on. A sweep that shows no road
    is named: that nothing is found in it says nothing.

    Examples:

        headsup detect sweep.bin --out out/detect

        headsup detect drive/*.laz --out out/detect --sensor-height 1.73

        headsup detect sweep.pcd --out out/saliency --method saliency
    """
    from rich.console import Console
    from rich.progress import track

    from detector.errors import DetectorError
    from headsup.compiling import said_while_compiling
    from vehicle_client.sources.frame import SourceError

    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        _complain(f"{out}: cannot be made: {error.strerror}")
        raise typer.Exit(1) from error
    failed = 0
    names = output_names(files)
    for path in track(list(names), description="detecting", console=Console(stderr=True), transient=True):
        try:
            with said_while_compiling("detect"):
                detect_file(path, out, names[path], method, sensor_height)
        except (SourceError, DetectorError, OSError) as error:
            failed += 1
            message = str(error)
            _complain(message if str(path) in message else f"{path}: {message}")
    if failed:
        raise typer.Exit(1)


def detect_file(path: Path, out: Path, name: str, method: str, sensor_height_m: float | None) -> None:
    """Write the results of one file as `out/name.*`; the height of the sensor is estimated if it is None."""
    from detector.pipeline import detect, estimate_sensor_height
    from detector.types import DetectorInput
    from headsup.detection_picture import draw_detection
    from vehicle_client.sources.files import read_cloud

    frame = read_cloud(path)
    height_m = estimate_sensor_height(frame.points_m) if sensor_height_m is None else sensor_height_m
    detection = detect(DetectorInput(frame.points_m, height_m), MethodName(method).value)
    _write(out, name, detection)
    if not detection.road_seen:
        typer.echo(f"{path}: no road in view: that nothing is found there says nothing about the road")
    draw_detection(out / f"{name}.png", frame.points_m, detection, height_m, name)


def output_names(files: Sequence[Path]) -> dict[Path, str]:
    """Name of each file's results, all different: its stem, with the folder before it where stems are equal."""
    paths = list(dict.fromkeys(files))
    names = {path: path.stem for path in paths}
    for describe in (_with_folder, _with_folder_and_ending):
        counts = Counter(names.values())
        names = {path: describe(path) if counts[name] > 1 else name for path, name in names.items()}
    counted: Counter[str] = Counter()
    for path, name in names.items():
        counted[name] += 1
        names[path] = name if counted[name] == 1 else f"{name}_{counted[name]}"
    return names


def obstacle_record(obstacle: DetectedObstacle) -> dict[str, object]:
    """An obstacle as JSON; lengths in metres in the sensor's frame, `points` is the number of points on it."""
    extent = "depth_m" if obstacle.kind.is_negative else "height_m"
    descriptor = obstacle.descriptor
    return {
        "kind": obstacle.kind.value,
        "centre_m": [float(value) for value in obstacle.centre_m],
        "length_m": float(obstacle.length_m),
        "width_m": float(obstacle.width_m),
        extent: float(obstacle.relief_m),
        "yaw_rad": float(obstacle.yaw_rad),
        "volume_m3": float(obstacle.volume_m3),
        "confidence": float(obstacle.confidence),
        "points": int(obstacle.hits),
        "descriptor": {
            "name": descriptor.name,
            "version": descriptor.version,
            "values": {key: float(value) for key, value in descriptor.values.items()},
        },
    }


def _write(out: Path, name: str, detection: FrameDetection) -> None:
    import numpy as np

    np.save(out / f"{name}.labels.npy", detection.labels)
    np.save(out / f"{name}.saliency.npy", detection.saliency)
    records = [obstacle_record(obstacle) for obstacle in detection.obstacles]
    (out / f"{name}.obstacles.json").write_text(json.dumps(records, indent=1) + "\n")


def _with_folder(path: Path) -> str:
    return f"{path.absolute().parent.name}_{path.stem}"


def _with_folder_and_ending(path: Path) -> str:
    return f"{path.absolute().parent.name}_{path.name.replace('.', '_')}"


def _complain(message: str) -> None:
    typer.secho(f"headsup detect: {message}", err=True, fg=typer.colors.RED)
