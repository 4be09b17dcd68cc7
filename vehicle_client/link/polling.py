"""The way to the server's obstacles where WebSockets do not pass: `GET /v1/obstacles`, every few seconds."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import httpx
from pydantic import ValidationError

from contract.geometry import LatLon
from contract.obstacle import ObstacleCollection, ObstacleFeature
from vehicle_client.area import Area, Strip, Surveyed, distance_m
from vehicle_client.link.http_asking import Answer, ask
from vehicle_client.link.push import AREA_RADIUS_M

AHEAD_RADIUS_M = 1_000.0
"""What is polled is older than what is pushed: at 130 km/h the car drives 180 m while it waits and asks."""

CORRIDOR_M = 500.0
"""Full width of the strip ahead: a bend of 250 m radius leaves it after 400 m, where warnings begin."""

MOST_PAGES = 5
"""Of a thousand obstacles each; the nearest come first, so that what is cut off is far away."""

ANSWER_WITHIN_S = 10.0

_PATH = "/v1/obstacles"


class PollError(RuntimeError):
    """The server did not answer, or not in this contract. `status` is what it answered, if it did."""

    def __init__(self, what: str, *, status: int | None = None) -> None:
        super().__init__(what)
        self.status = status


@dataclass(frozen=True, slots=True)
class _Page:
    """What was answered to the first page of a question, and all that it led to."""

    tag: str
    obstacles: tuple[ObstacleFeature, ...]
    is_whole: bool


class Poller:
    """Asks for what lies around or ahead, and remembers the last answer by its entity tag."""

    def __init__(self, client: httpx.Client) -> None:
        self._client = client
        self._last: _Page | None = None

    def poll(self, position: LatLon, heading_rad: float | None = None) -> Surveyed:
        """All obstacles of the circle around the car, or, with a heading, of the strip ahead. Raises `PollError`."""
        area = _area(position, heading_rad)
        headers = {"if-none-match": self._last.tag} if self._last else {}
        answer = self._asked(_PATH, headers, _parameters(area))
        if answer.status == httpx.codes.NOT_MODIFIED and self._last is not None:
            return Surveyed(area, self._last.obstacles)
        page = self._whole(answer)
        if page.is_whole:
            self._last = page
            return Surveyed(area, page.obstacles)
        self._last = None
        farthest_m = max((distance_m(position, o.position) for o in page.obstacles), default=0.0)
        return Surveyed(replace(area, radius_m=min(area.radius_m, farthest_m)), page.obstacles)

    def _whole(self, answer: Answer) -> _Page:
        tag = answer.headers.get("etag", "")
        obstacles: list[ObstacleFeature] = []
        for page in range(MOST_PAGES):
            collection = _collection(answer)
            obstacles += collection.features
            following = next((link.href for link in collection.links if link.rel == "next"), None)
            if following is None:
                return _Page(tag, tuple(obstacles), is_whole=True)
            # Relative to the server, and nowhere else: the key goes with the request.
            if not following.startswith(f"{_PATH}?"):
                raise PollError("the server's next page lies outside of its obstacles")
            if page < MOST_PAGES - 1:
                answer = self._asked(following, {}, None)
        return _Page(tag, tuple(obstacles), is_whole=False)

    def _asked(self, url: str, headers: dict[str, str], parameters: dict[str, str] | None) -> Answer:
        try:
            answer = ask(self._client, "GET", url, within_s=ANSWER_WITHIN_S, headers=headers, params=parameters)
        except (httpx.RequestError, httpx.InvalidURL) as error:
            raise PollError(f"no answer: {error!r}") from error
        if answer.status not in (httpx.codes.OK, httpx.codes.NOT_MODIFIED):
            raise PollError(f"the server answered {answer.status}", status=answer.status)
        return answer


def _collection(answer: Answer) -> ObstacleCollection:
    try:
        return ObstacleCollection.model_validate_json(answer.content)
    except ValidationError as error:
        raise PollError("the server's obstacles are not of this contract") from error


def _area(position: LatLon, heading_rad: float | None) -> Area:
    if heading_rad is None:
        return Area(position, AREA_RADIUS_M)
    # Whole degrees: the strip is wide, and no more need be said.
    heading_deg = round(math.degrees(heading_rad)) % 360
    return Area(position, AHEAD_RADIUS_M, Strip(math.radians(heading_deg), CORRIDOR_M))


def _parameters(area: Area) -> dict[str, str]:
    where = {
        "lat": str(area.centre.latitude_deg),
        "lon": str(area.centre.longitude_deg),
        "radius_m": f"{area.radius_m:.0f}",
    }
    if area.ahead is None:
        return where
    heading = {"heading_deg": f"{math.degrees(area.ahead.heading_rad):.0f}", "corridor_m": f"{area.ahead.width_m:.0f}"}
    return where | heading
