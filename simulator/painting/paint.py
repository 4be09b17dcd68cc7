"""What surfaces look like: each hit is painted by its surface's painter, in the frame that painter works in."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from simulator.painting.paint_asphalt import AsphaltPaint
from simulator.painting.paint_objects import paint_car, paint_facade, paint_wheel
from simulator.painting.paint_stone import StonePaint
from simulator.painting.sky import Daylight
from simulator.painting.view import Paint, View
from simulator.scene.scenery import Part, Surface
from simulator.shapes.debris import WOOD
from simulator.streets.street import Street

Float32Array = NDArray[np.float32]


class Painter:
    """Paint of one street and its parts."""

    def __init__(self, street: Street, parts: list[Part], daylight: Daylight) -> None:
        self._asphalt = AsphaltPaint(street, daylight)
        self._road = np.array([part.road for part in parts])
        self._stone = StonePaint(street.seed)
        self._daylight = daylight
        self._colours = np.array([part.colour for part in parts], dtype=np.float32)
        stone = self._stone
        self._painters: dict[int, Callable[[View], Paint]] = {
            Surface.ROAD: lambda view: self._asphalt.paint(view, self._road[view.part]),
            Surface.KERB: stone.kerb,
            Surface.PAVEMENT: stone.pavement,
            Surface.GROUND: stone.ground,
            Surface.WALL: stone.wall,
            Surface.BUILDING: self._facade,
            Surface.ROOF: lambda view: stone.roof(view, view.local()[0], self._colour(view)),
            Surface.CAR: lambda view: paint_car(view, *view.local(), self._colour(view), daylight),
            Surface.WHEEL: lambda view: paint_wheel(view, *view.local()),
            Surface.TREE: lambda view: stone.leaves(view, view.local()[0], self._colour(view)),
            Surface.DEBRIS: self._debris,
        }

    def paint(self, view: View) -> Paint:
        """Paint of all hits, in their order."""
        count = len(view.part)
        result = Paint(
            np.empty((count, 3), np.float32), np.zeros((count, 3), np.float32), np.ones(count, dtype=np.float32)
        )
        for surface in np.unique(view.surface):
            chosen = np.flatnonzero(view.surface == surface)
            paint = self._painters.get(int(surface), self._plain)(view.only(chosen))
            result.albedo[chosen], result.glow[chosen] = paint.albedo, paint.glow
            result.openness[chosen] = paint.openness
        return result

    def _facade(self, view: View) -> Paint:
        local, normal = view.local()
        plaster = self._stone.plaster(local, view.pixel_m)
        return paint_facade(view, local, normal, self._colour(view), plaster, self._daylight)

    def _debris(self, view: View) -> Paint:
        """Boards show their grain; all else on the road has one colour."""
        paint = self._plain(view)
        boards = np.flatnonzero((self._colour(view) == np.asarray(WOOD, dtype=np.float32)).all(axis=1))
        wooden = view.only(boards)
        paint.albedo[boards] = self._stone.wood(wooden, wooden.local()[0], self._colour(wooden)).albedo
        return paint

    def _plain(self, view: View) -> Paint:
        return self._stone.plain(view, self._colour(view))

    def _colour(self, view: View) -> Float32Array:
        return self._colours[view.part]
