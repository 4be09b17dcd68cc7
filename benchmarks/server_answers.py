"""What servers answer to the same queries: whether they found the same obstacles, and how many."""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import islice
from statistics import mean
from urllib.request import Request, urlopen

from benchmarks.server_turns import Subject

_ASKED = 50


def found(url: str, key: str = "") -> list[str]:
    """Ids of the obstacles in an answer, in order; raises `OSError` when it is not 2xx, `ValueError` if not JSON."""
    request = Request(url, headers={"Authorization": f"Bearer {key}"} if key else {})  # noqa: S310  # of our own
    with urlopen(request, timeout=20) as answer:  # noqa: S310  # of our own
        return [str(feature["id"]) for feature in json.load(answer)["features"]]


def found_by(subject: Subject) -> list[list[str]]:
    """What it finds with each of its first queries."""
    with subject.load.lines.open(encoding="ascii") as file:
        return [found(subject.server.url + line.strip(), subject.load.key) for line in islice(file, _ASKED)]


def comparison(answered: Sequence[tuple[str, list[list[str]]]]) -> str:
    """A sentence on what each found, against the first; all were asked about the same places."""
    own = answered[0][1]
    told = [f"{answered[0][0]} {_mean(own):.1f}"]
    for name, answers in answered[1:]:
        same = sum(answer == expected for answer, expected in zip(answers, own, strict=True))
        told.append(f"{name} {_mean(answers):.1f} ({same} of {len(own)} the same in the same order)")
    return f"Obstacles in an answer, mean of {len(own)}: " + ", ".join(told) + "."


def _mean(answers: list[list[str]]) -> float:
    return mean(map(len, answers))
