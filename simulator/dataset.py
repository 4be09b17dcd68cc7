"""Many recordings in one folder: which are there, which are missing, how they are split, and what they hold."""

from __future__ import annotations

import fcntl
import json
import os
import re
import shutil
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from simulator.record import RecordingPlan
from simulator.recording.files import json_bytes, write_whole

BLOCK = ("train",) * 14 + ("val",) * 3 + ("test",) * 3
"""Of every twenty drives in a row: 70, 15 and 15 %. A larger data set of the same first seed keeps the split."""

OWN_FILES = re.compile(
    r"(ego\d+\.mcap|obstacles\.json|overview\.png|recording\.json"
    r"|ego\d+/[\w.-]+\.(csv|txt)"
    r"|ego\d+/sensor\.[\w.-]+/(\w+_metadata\.txt|(labels/)?\d{5,}\.(ply|png|npz)))(\.part)?"
)
"""What a recording's folder holds; a folder with any other file is not removed."""

RESERVE = 1.05
"""Drives differ in size; of a hundred, the sum differs from a multiple of the first by a few per cent (measured)."""


class DatasetError(ValueError):
    """A data set cannot be made as asked; the message says why."""


@dataclass(frozen=True, slots=True)
class PlannedDrive:
    """One recording of a data set: its folder, what it is to be, and which part of the split it belongs to."""

    folder: Path
    plan: RecordingPlan
    split: str

    @property
    def is_there(self) -> bool:
        """Whether the folder holds this recording, whole. `DatasetError` names what it was made from otherwise."""
        try:
            found = json.loads((self.folder / "recording.json").read_bytes())
        except FileNotFoundError:
            return False
        except ValueError:
            raise DatasetError(f"{self.folder}/recording.json is not JSON; remove the folder") from None
        differences = list(_differences(self.plan, found if isinstance(found, dict) else {}))
        if differences:
            raise DatasetError(
                f"{self.folder} was made with other options: {'; '.join(differences)}. Give those, or another folder"
            )
        return True

    def clear(self) -> None:
        """Remove what an unfinished recording left. `DatasetError` if the folder holds anything else."""
        if not self.folder.exists():
            return
        strange = [] if self.folder.is_dir() else [self.folder.name]
        files = (str(p.relative_to(self.folder)) for p in self.folder.rglob("*") if not p.is_dir() or p.is_symlink())
        strange = strange or sorted(name for name in files if not OWN_FILES.fullmatch(name))
        if strange:
            raise DatasetError(f"{self.folder} is no unfinished recording: it holds {strange[0]}. Give another folder")
        shutil.rmtree(self.folder)

    @property
    def frames(self) -> int:
        """Of all vehicles."""
        return self.plan.frames * self.plan.scenario.egos

    @property
    def size_bytes(self) -> int:
        """Of all files."""
        return sum(path.stat().st_size for path in self.folder.rglob("*") if path.is_file())


def planned(out: Path, plans: Sequence[RecordingPlan]) -> list[PlannedDrive]:
    """`out/0001`, `out/0002`, ... of plans whose seeds count up."""
    seed = plans[0].scenario.seed
    return [
        PlannedDrive(out / f"{number:04d}", plan, split_of(seed, number)) for number, plan in enumerate(plans, start=1)
    ]


def split_of(first_seed: int, number: int) -> str:
    """`train`, `val` or `test` of the drive of that number, from 1: whole drives, each its own street."""
    block, place = divmod(number - 1, len(BLOCK))
    return BLOCK[np.random.default_rng([first_seed, block, 41]).permutation(len(BLOCK))[place]]


@contextmanager
def alone(out: Path) -> Iterator[None]:
    """Make the folder, and keep any other process from making drives there. `DatasetError` if one does."""
    out.mkdir(parents=True, exist_ok=True)
    folder = os.open(out, os.O_RDONLY)
    try:
        try:
            fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise DatasetError(f"{out}: another command makes drives there; give another folder") from None
        yield
    finally:
        os.close(folder)


def check_room(out: Path, made: Sequence[PlannedDrive], missing: int) -> None:
    """`DatasetError` if the disk has no room for so many drives more of the mean size of those that are made."""
    if not made or not missing:
        return
    needed = RESERVE * missing * sum(drive.size_bytes for drive in made) / len(made)
    free = shutil.disk_usage(out).free
    if needed > free:
        raise DatasetError(
            f"{out}: the {missing} drives that are missing need about {needed / 1e9:.1f} GB, and {free / 1e9:.1f} GB "
            "are free. Make room and run again, or leave out --images or --mcap, or make fewer drives"
        )


@dataclass(frozen=True, slots=True)
class Content:
    """What one recording holds; `frames` of each vehicle, `obstacles` by kind, `changes` by what happened."""

    folder: str
    seed: int
    split: str
    georeference: dict[str, float]
    frames: list[int]
    sweeps: int
    points: int
    pictures: int
    obstacles: dict[str, int]
    changes: dict[str, int]
    bytes: int


def write_dataset(out: Path, drives: Sequence[PlannedDrive]) -> list[Content]:
    """Write `dataset.json` of whole recordings, and return what they hold."""
    contents = [_content(drive) for drive in drives]
    plan = drives[0].plan
    parts = dict.fromkeys(BLOCK)
    description = {
        "layout": "headsup-dataset",
        "version": 1,
        "made_by": "headsup simulate dataset",
        "first_seed": plan.scenario.seed,
        "asked": plan.asked,
        "sensors": [dict(entry) for entry in plan.sensors],
        "split": {part: [drive.folder.name for drive in drives if drive.split == part] for part in parts},
        "totals": _totals(contents),
        "drives": [asdict(content) for content in contents],
    }
    write_whole(out / "dataset.json", json_bytes(description))
    return contents


def _content(drive: PlannedDrive) -> Content:
    recording = json.loads((drive.folder / "recording.json").read_bytes())
    truth = json.loads((drive.folder / "obstacles.json").read_bytes())
    kinds = {row["obstacle_id"]: row["kind"] for row in truth}
    return Content(
        folder=drive.folder.name,
        seed=drive.plan.scenario.seed,
        split=drive.split,
        georeference=recording["georeference"],
        frames=[ego["frames"] for ego in recording["egos"]],
        sweeps=len(list(drive.folder.glob("ego*/sensor.lidar.*/*.ply"))),
        points=sum(_points(path) for path in drive.folder.glob("ego*/sensor.lidar.*/lidar_metadata.txt")),
        pictures=len(list(drive.folder.glob("ego*/sensor.camera.*/*.png"))),
        obstacles=_sorted(Counter(kinds.values())),
        changes=_sorted(Counter(row["change"] for row in truth if row["change"] != "initial")),
        bytes=drive.size_bytes,
    )


def _points(metadata: Path) -> int:
    return sum(int(count) for count in re.findall(r"number_of_points=(\d+)", metadata.read_text(encoding="ascii")))


def _totals(contents: Sequence[Content]) -> dict[str, object]:
    return {
        "drives": len(contents),
        "frames": sum(sum(one.frames) for one in contents),
        "sweeps": sum(one.sweeps for one in contents),
        "points": sum(one.points for one in contents),
        "pictures": sum(one.pictures for one in contents),
        "obstacles": _sorted(sum((Counter(one.obstacles) for one in contents), Counter())),
        "changes": _sorted(sum((Counter(one.changes) for one in contents), Counter())),
        "bytes": sum(one.bytes for one in contents),
    }


def _sorted(counted: Counter[str]) -> dict[str, int]:
    return dict(sorted(counted.items()))


def _differences(plan: RecordingPlan, found: Mapping[str, object]) -> Iterator[str]:
    """What a recording.json says that the plan does not, in words."""
    stated = {"seed": plan.scenario.seed, **plan.asked, "sensors": [dict(entry) for entry in plan.sensors]}
    wanted = _flat(json.loads(json_bytes(stated)))
    asked = found.get("asked")
    was = _flat(
        {"seed": found.get("seed"), "sensors": found.get("sensors"), **(asked if isinstance(asked, dict) else {})}
    )
    for name in dict.fromkeys([*wanted, *was]):
        one, other = json.dumps(wanted.get(name)), json.dumps(was.get(name))
        if one != other:
            yield f"{name} {other}, not {one}" if len(one) + len(other) < 60 else f"other {name}"


def _flat(stated: Mapping[str, object]) -> dict[str, object]:
    """The world's properties beside all others."""
    world = stated.get("world")
    return {name: value for name, value in stated.items() if name != "world"} | (
        world if isinstance(world, dict) else {}
    )
