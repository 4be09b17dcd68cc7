"""A vehicle of the fault tests: puts numbered reports and delivers them, in this process or as one that is killed.

As a program: `python -m tests.integration.faulty_drive URL OUTBOX FIRST LAST START_S` prints each number once its
report is in the outbox, and `done` once all have been answered.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from random import Random

from contract.geometry import LatLon
from contract.observation import ObservationReport
from tests.unit.server.making import PATRAS, detection, message
from vehicle_client.link.background import BackgroundLink
from vehicle_client.link.server_link import ServerLink

HASTE = 200.0
"""Waits pass so much faster than in a car: five minutes in 1.5 s."""

TIMEOUT_S = 0.5


def report(number: int, start: datetime) -> ObservationReport:
    """The same report for the same number, with an obstacle of its own, rich enough to be cut in half."""
    random = Random(number)  # noqa: S311  # not a secret
    points = tuple((random.randint(-50, 50), random.randint(-50, 50), random.randint(-10, 0)) for _ in range(64))
    place = detection(random.uniform(-100, 100), random.uniform(-40, 40)).model_copy(update={"points_cm": points})
    return message(place, at=start + timedelta(seconds=number), number=number)


def along(number: int) -> LatLon:
    return LatLon(latitude_deg=PATRAS.latitude_deg + number / 1e4, longitude_deg=PATRAS.longitude_deg)


@contextmanager
def link_to(url: str, outbox: Path, seed: int) -> Iterator[BackgroundLink]:
    def hasty() -> float:
        return time.monotonic() * HASTE

    jitter = Random(seed)  # noqa: S311  # not a secret
    link = ServerLink(url, None, outbox, timeout_s=TIMEOUT_S, jitter=jitter, clock=hasty)
    with BackgroundLink(link, stop_within_s=1.0) as background:
        yield background


def main() -> None:
    url, outbox, first, last, start_s = sys.argv[1:]
    start = datetime.fromtimestamp(float(start_s), UTC)
    with link_to(url, Path(outbox), int(first)) as link:
        for number in range(int(first), int(last)):
            link.put(report(number, start))
            print(number, flush=True)
            link.hear(along(number))
            time.sleep(0.02)
        while link.status.waiting:
            link.hear(along(int(last)))
            time.sleep(0.05)
    print("done", flush=True)


if __name__ == "__main__":
    main()
