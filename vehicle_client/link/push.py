"""The WebSocket to the server: the car says where it is and hears what appears, changes or goes around it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack
from datetime import UTC, datetime
from urllib.parse import urlsplit, urlunsplit

from pydantic import ValidationError
from websockets.exceptions import ConnectionClosed, InvalidStatus, WebSocketException
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from contract.events import SUBPROTOCOL, Moved, Position, ServerMessage, Snapshot, server_message
from contract.geometry import LatLon
from vehicle_client.area import Area, Heard, Reached, Surveyed
from vehicle_client.link.back_off import retry_after_s

AREA_RADIUS_M = 600.0
"""Beyond the longest distance of a warning (400 m) by what the car's position is coarsened (80 m) and what it drives
between two exchanges (60 m), so that an obstacle is known before it is announced."""

MAX_MESSAGE_BYTES = 8 << 20
"""A snapshot of a dense city within 2 km; the server is trusted no further than that."""

PING_S = 20.0
"""A connection that a network has silently forgotten is found out within twice this, also by a car that stands."""


class PushError(RuntimeError):
    """The push channel is gone or speaks another language; the vehicle goes on with the map it has.

    `status` is that of a refused handshake, `wait_s` what the server asked to wait.
    """

    def __init__(self, what: str, *, status: int | None = None, wait_s: float | None = None) -> None:
        super().__init__(what)
        self.status, self.wait_s = status, wait_s


class PushChannel:
    """One connection. `exchange` sends a position and waits until the server has acknowledged it, so that what the map
    says is what the server knew there."""

    def __init__(self, server_url: str, api_key: str | None, *, timeout_s: float = 5.0) -> None:
        headers = {"Authorization": f"Bearer {api_key}"} if api_key else {}
        self._timeout_s = timeout_s
        self._position_seq = 0
        self._areas: dict[int, Area] = {}
        self._open = ExitStack()
        try:
            connection = connect(
                _events_url(server_url),
                subprotocols=[Subprotocol(SUBPROTOCOL)],
                additional_headers=headers,
                open_timeout=timeout_s,
                close_timeout=timeout_s,
                ping_interval=PING_S,
                ping_timeout=PING_S,
                compression=None,
                max_size=MAX_MESSAGE_BYTES,
            )
            self._connection: ClientConnection = self._open.enter_context(connection)
        except InvalidStatus as error:
            response = error.response
            wait_s = retry_after_s(response.headers.get("Retry-After"), datetime.now(UTC))
            raise PushError(
                f"no push channel to {server_url}: {error}", status=response.status_code, wait_s=wait_s
            ) from error
        except (OSError, WebSocketException, EOFError, ValueError) as error:
            raise PushError(f"no push channel to {server_url}: {error}") from error
        if connection.subprotocol != SUBPROTOCOL:
            self.close()
            raise PushError(f"no push channel to {server_url}: what answers there does not speak {SUBPROTOCOL}")

    def exchange(self, position: LatLon) -> list[Heard]:
        """Say where the car is; returns all that the server sent up to its acknowledgement."""
        self._position_seq += 1
        message = Position(position_seq=self._position_seq, position=position, radius_m=AREA_RADIUS_M)
        self._areas[self._position_seq] = Area(position, AREA_RADIUS_M)
        try:
            self._connection.send(message.model_dump_json())
            heard = list(self._until_acknowledged(time.monotonic() + self._timeout_s))
        except TimeoutError as error:
            raise PushError(f"the position was not acknowledged within {self._timeout_s} s") from error
        except (ConnectionClosed, OSError) as error:
            raise PushError(f"the push channel broke: {error}") from error
        except ValidationError as error:
            raise PushError("the server sent a message that is not of this contract") from error
        self._areas = {self._position_seq: self._areas[self._position_seq]}
        return heard

    def _until_acknowledged(self, deadline_s: float) -> Iterator[Heard]:
        while True:
            remaining_s = deadline_s - time.monotonic()
            if remaining_s <= 0:
                raise TimeoutError
            message = server_message.validate_json(self._connection.recv(timeout=remaining_s))
            yield self._placed(message)
            if isinstance(message, Snapshot | Moved) and message.position_seq >= self._position_seq:
                return

    def _placed(self, message: ServerMessage) -> Heard:
        """The message with the area that it speaks of, instead of the number of a position."""
        if not isinstance(message, Snapshot | Moved):
            return message
        area = self._areas.get(message.position_seq)
        if area is None:
            raise PushError(f"the server speaks of position {message.position_seq}, which was not sent")
        return Surveyed(area, message.obstacles) if isinstance(message, Snapshot) else Reached(area)

    def close(self) -> None:
        """Say good-bye."""
        self._open.close()


def _events_url(server_url: str) -> str:
    parts = urlsplit(server_url)
    scheme = "wss" if parts.scheme == "https" else "ws"
    return urlunsplit((scheme, parts.netloc, parts.path.rstrip("/") + "/v1/events", "", ""))
