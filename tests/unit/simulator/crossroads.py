"""The example map `docs/examples/crossroads.xodr`: `python tests/unit/simulator/crossroads.py` writes it anew.

Four arms leave a crossing, each drawn from it outwards: a curve with superelevation to the east, a hill to the north,
a double bend to the west, and to the south a second lane section with a parking lane. Traffic drives on the right.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

EXAMPLE = Path(__file__).parents[3] / "docs" / "examples" / "crossroads.xodr"

BOX_M, LANE_M, PAVEMENT_M = 16.0, 3.5, 2.0
EAST, NORTH, WEST, SOUTH = 1, 2, 3, 4
JUNCTION = 100

SHAPES: dict[int, list[tuple[float, float, float]]] = {
    EAST: [(70, 0, 0), (30, 0, 1 / 80), (60, 1 / 80, 1 / 80), (30, 1 / 80, 0), (110, 0, 0)],
    NORTH: [(320, 0, 0)],
    WEST: [(60, 0, 0), (25, 0, -1 / 60), (25, -1 / 60, 0), (25, 0, 1 / 60), (25, 1 / 60, 0), (140, 0, 0)],
    SOUTH: [(300, 0, 0)],
}
"""Length and the curvature at both ends of each piece of an arm."""

ELEVATION = {
    # Up by 4 % from 20 to 200 m, over rounded ends of 40 m, to a plateau.
    NORTH: [(0, 0, 0, 0), (20, 0, 0, 5e-4), (60, 0.8, 0.04, 0), (160, 4.8, 0.04, -5e-4), (200, 5.6, 0, 0)],
    WEST: [(0, 0, 0, 0), (30, 0, 0, -2.5e-4), (70, -0.4, -0.02, 0), (200, -3.0, -0.02, 2.5e-4), (240, -3.4, 0, 0)],
}
"""s, and the height's coefficients a, b, c from there on."""

CURVE_ROLL_RAD = -0.035


def crossroads() -> str:
    """The map as text."""
    headings = {EAST: 0.0, NORTH: math.pi / 2, WEST: math.pi, SOUTH: -math.pi / 2}
    roads = [_arm(arm, heading) for arm, heading in headings.items()]
    connections = []
    for number, (here, there, turn) in enumerate(
        (here, there, round((headings[there] - headings[here] - math.pi) / (math.pi / 2)) % 4)
        for here in headings
        for there in headings
        if here != there
    ):
        roads.append(_connection(10 + number, here, there, headings[here] + math.pi, {0: 0, 1: 1, 3: -1}[turn]))
        connections.append(
            f'    <connection id="{number}" incomingRoad="{here}" connectingRoad="{10 + number}" '
            'contactPoint="start">\n'
            '      <laneLink from="1" to="-1"/>\n    </connection>'
        )
    place = "+proj=tmerc +lat_0=38.2466 +lon_0=21.7346 +k=1 +x_0=0 +y_0=0 +datum=WGS84 +units=m +no_defs"
    return "\n".join(
        [
            '<?xml version="1.0" encoding="UTF-8"?>',
            "<OpenDRIVE>",
            '  <header revMajor="1" revMinor="4" name="crossroads" version="1.00">',
            f"    <geoReference><![CDATA[{place}]]></geoReference>",
            "  </header>",
            *roads,
            f'  <junction id="{JUNCTION}" name="crossing">',
            *connections,
            "  </junction>",
            "</OpenDRIVE>",
            "",
        ]
    )


def _arm(arm: int, heading: float) -> str:
    """An arm with a lane each way between pavements; lane 1 leads to the crossing."""
    pieces = SHAPES[arm]
    length = sum(piece[0] for piece in pieces)
    plan = _plan(BOX_M * math.cos(heading), BOX_M * math.sin(heading), heading, pieces)
    both = ['<predecessor id="{0}"/>', '<successor id="{0}"/>']
    middle = _mark("solid", "yellow") if arm == WEST else _mark("broken")
    sections = [_section(0, middle, ["", ""], parking=False)]
    if arm == SOUTH:
        sections = [
            _section(0, middle, ["", both[1]], parking=False),
            _section(120, middle, [both[0], ""], parking=True),
        ]
    heights = ELEVATION.get(arm, [(0, 0, 0, 0)])
    roll = [(0, 0, 0, 0), (70, 0, CURVE_ROLL_RAD / 30, 0), (100, CURVE_ROLL_RAD, 0, 0)]
    roll += [(160, CURVE_ROLL_RAD, -CURVE_ROLL_RAD / 30, 0), (190, 0, 0, 0)]
    return _road(
        arm,
        length,
        f'<predecessor elementType="junction" elementId="{JUNCTION}"/>',
        plan,
        _cubics("elevation", heights),
        _cubics("superelevation", roll if arm == EAST else [(0, 0, 0, 0)]),
        sections,
        -1,
    )


def _connection(number: int, here: int, there: int, heading: float, turn: int) -> str:
    """A way through the crossing; `turn` is 0 straight on, 1 left, -1 right, where the pavement follows it."""
    x, y = -BOX_M * math.cos(heading), -BOX_M * math.sin(heading)
    length = math.pi / 2 * BOX_M if turn else 2 * BOX_M
    link = '<predecessor id="1"/><successor id="-1"/>'
    right = [_lane(-1, "driving", LANE_M, link)]
    if turn < 0:
        right.append(_lane(-2, "sidewalk", PAVEMENT_M, ""))
    section = _lanes(0, [], "", right)
    return _road(
        number,
        length,
        f'<predecessor elementType="road" elementId="{here}" contactPoint="start"/>'
        f'<successor elementType="road" elementId="{there}" contactPoint="start"/>',
        _plan(x, y, heading, [(length, turn / BOX_M, turn / BOX_M)]),
        _cubics("elevation", [(0, 0, 0, 0)]),
        _cubics("superelevation", [(0, 0, 0, 0)]),
        [section],
        JUNCTION,
    )


def _section(s: float, middle: str, links: list[str], *, parking: bool) -> str:
    before, after = links
    left, right = ((before + after).format(sign) for sign in (1, -1))
    solid = _mark("solid")
    beside = [_lane(-2, "parking", 2.2, ""), _lane(-3, "sidewalk", PAVEMENT_M, "")]
    return _lanes(
        s,
        [_lane(2, "sidewalk", PAVEMENT_M, ""), _lane(1, "driving", LANE_M, left, solid)],
        middle,
        [_lane(-1, "driving", LANE_M, right, solid)] + (beside if parking else [_lane(-2, "sidewalk", PAVEMENT_M, "")]),
    )


def _lanes(s: float, left: list[str], middle: str, right: list[str]) -> str:
    sides = f"<left>\n{''.join(left)}        </left>\n        " if left else ""
    return (
        f'      <laneSection s="{s:g}">\n        {sides}'
        f'<center><lane id="0" type="none" level="false">{middle}</lane></center>\n'
        f"        <right>\n{''.join(right)}        </right>\n      </laneSection>\n"
    )


def _lane(number: int, kind: str, width: float, link: str, mark: str = "") -> str:
    return (
        f'          <lane id="{number}" type="{kind}" level="false"><link>{link}</link>'
        f'<width sOffset="0" a="{width:g}" b="0" c="0" d="0"/>{mark}</lane>\n'
    )


def _mark(kind: str, colour: str = "white") -> str:
    return f'<roadMark sOffset="0" type="{kind}" weight="standard" color="{colour}" width="0.12"/>'


def _cubics(name: str, records: list[tuple[float, float, float, float]]) -> str:
    return "".join(f'<{name} s="{s:g}" a="{a:g}" b="{b!r}" c="{c:g}" d="0"/>' for s, a, b, c in records)


def _road(
    number: int, length: float, link: str, plan: str, height: str, roll: str, sections: list[str], junction: int
) -> str:
    return (
        f'  <road name="" length="{length!r}" id="{number}" junction="{junction}">\n    <link>{link}</link>\n'
        f"    <planView>\n{plan}    </planView>\n    <elevationProfile>{height}</elevationProfile>\n"
        f"    <lateralProfile>{roll}</lateralProfile>\n    <lanes>\n{''.join(sections)}    </lanes>\n  </road>"
    )


def _plan(x: float, y: float, heading: float, pieces: list[tuple[float, float, float]]) -> str:
    """Geometries of pieces with curvatures that are constant (lines, arcs) or linear (clothoids)."""
    text, s = "", 0.0
    for length, start, end in pieces:
        shape = f'<spiral curvStart="{start!r}" curvEnd="{end!r}"/>'
        if start == end:
            shape = f'<arc curvature="{start!r}"/>' if start else "<line/>"
        # Nanometres: what is left of a sine's rounding differs between machines.
        text += (
            f'      <geometry s="{s!r}" x="{round(x, 9) + 0.0!r}" y="{round(y, 9) + 0.0!r}" '
            f'hdg="{round(heading, 12)!r}" length="{length!r}">{shape}</geometry>\n'
        )
        along = np.linspace(0, length, 4_001)
        turned = heading + start * along + (end - start) * along**2 / (2 * length)
        x += float(np.trapezoid(np.cos(turned), along))
        y += float(np.trapezoid(np.sin(turned), along))
        heading, s = float(turned[-1]), s + length
    return text


if __name__ == "__main__":
    EXAMPLE.parent.mkdir(exist_ok=True)
    EXAMPLE.write_text(crossroads())
