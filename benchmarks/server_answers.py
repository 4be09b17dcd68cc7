"""What servers answer to the same queries: whether they found the same obstacles, and how many."""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import islice
from statistics import mean
from urllib.request import Request, urlopen

from benchmarks.server_turns import Subject

_ASKED = 50


def found_by(subject: Subject) -> list[list[str]]:
    """Ids of the obstacles in each of its first answers, in order; raises `OSError` for an answer that is not 2xx."""
    with subject.load.lines.open(encoding="ascii") as file:
        return [_found(subject, line.strip()) for line in islice(file, _ASKED)]


def comparison(found: Sequence[tuple[str, list[list[str]]]]) -> str:
    """A sentence on what each found, against the first; all were asked about the same places."""
    own = found[0][1]
    told = [f"{found[0][0]} {_mean(own):.1f}"]
    for name, answers in found[1:]:
        same = sum(answer == expected for answer, expected in zip(answers, own, strict=True))
        told.append(f"{name} {_mean(answers):.1f} ({same} of {len(own)} the same in the same order)")
    return f"Obstacles in an answer, mean of {len(own)}: " + ", ".join(told) + "."


def _mean(answers: list[list[str]]) -> float:
    return mean(map(len, answers))


def _found(subject: Subject, path: str) -> list[str]:
    request = Request(subject.server.url + path)  # noqa: S310  # a server that we have started
    if subject.load.key:
        request.add_header("Authorization", f"Bearer {subject.load.key}")
    with urlopen(request, timeout=20) as answer:  # noqa: S310
        return [str(feature["id"]) for feature in json.load(answer)["features"]]
