from __future__ import annotations

import pytest

from simulator.streets.street import first_light_street
from simulator.world import World


@pytest.fixture(scope="session")
def world() -> World:
    return World(first_light_street(seed=3))
