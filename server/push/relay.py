"""What other processes on the same database changed, told to the vehicles that are connected to this one.

Every event is in the log of its tile. Twice a second the tiles around this process's vehicles are asked for their
versions, in one statement, and the logs of those that rose are read. What this process decided it has told already.
"""

from __future__ import annotations

import asyncio
import logging
import random

from sqlalchemy.exc import DBAPIError

from contract.geometry import LatLon
from contract.obstacle import ObstacleFeature
from server.errors import ServiceError
from server.geometry.quadkey import MERCATOR_LATITUDE_DEG, tiles
from server.push.stream import LEAVING_RATIO, Hub, Near
from server.reading.tile_reader import TileReader
from server.storage.features import ObstacleEvent

_LOG = logging.getLogger(__name__)
# At 50 km/h a car comes 7 m nearer meanwhile, of the 160 m at which a driver is warned.
_INTERVAL_S = 0.5


class Relay:
    """Events of others for the hub of this process, from the tiles where its vehicles are."""

    def __init__(self, reader: TileReader, hub: Hub, near: Near) -> None:
        self._reader, self._hub, self._near = reader, hub, near
        self._told: dict[int, int] = {}

    async def near(self, centre: LatLon, radius_m: float) -> tuple[ObstacleFeature, ...]:
        """Live obstacles around a place where a vehicle is; what changes there afterwards will be told."""
        new = [tile for tile in _tiles(centre, radius_m) if tile not in self._told]
        if new:
            versions = await self._reader.versions_aside(new)
            for tile in new:
                self._told.setdefault(tile, versions.get(tile, 0))
        return await self._near(centre, radius_m)

    async def run(self) -> None:
        """Tell until cancelled; a round that fails is logged, and the next one tells all that was missed."""
        while True:
            # Replicas that started together drift apart.
            await asyncio.sleep(_INTERVAL_S * random.uniform(0.75, 1.25))  # noqa: S311  # jitter, not a secret
            try:
                await self.tell()
            except (ServiceError, DBAPIError, OSError) as error:
                _LOG.warning("events of other processes are late: %s", type(error).__name__)
            except Exception:  # nobody would notice that the rounds had ended, and vehicles would not be told
                _LOG.exception("events of other processes are late")

    async def tell(self) -> None:
        """Publish what was logged around this process's vehicles since the last call."""
        areas = self._hub.areas()
        watched = {tile for area in areas for tile in _tiles(area.position, LEAVING_RATIO * area.radius_m)}
        for tile in self._told.keys() - watched:
            del self._told[tile]
        if not self._told:
            return
        for tile, version in (await self._reader.versions_aside(list(self._told))).items():
            if version > self._told.get(tile, version):
                await self._tell_tile(tile, version)

    async def _tell_tile(self, tile: int, version: int) -> None:
        logged = await self._reader.logged(tile, self._told[tile])
        if logged is None:
            self._told[tile] = version
            self._hub.resynchronise()
            return
        for seq, body in logged:
            self._hub.publish(ObstacleEvent.of(ObstacleFeature.model_validate_json(body)))
            self._told[tile] = seq


def _tiles(centre: LatLon, radius_m: float) -> tuple[int, ...]:
    """Tiles of a circle; none beyond the map, where a circle touches tiles without number and no obstacle is taken."""
    return () if abs(centre.latitude_deg) > MERCATOR_LATITUDE_DEG else tiles(centre, radius_m)
