"""The WebSocket to the server: the car says where it is and hears what appears, changes or goes around it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack
from urllib.parse import urlsplit, urlunsplit

from pydantic import ValidationError
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidURI
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from contract.events import SUBPROTOCOL, Moved, Position, ServerMessage, Snapshot, server_message
from contract.geometry import LatLon

AREA_RADIUS_M = 500.0
"""Beyond the longest distance of a warning (400 m), so that an obstacle is known before it is announced."""

MAX_MESSAGE_BYTES = 8 << 20
"""A snapshot of a dense city within 2 km; the server is trusted no further than that."""


class PushError(RuntimeError):
    """The push channel is gone or speaks another language; the vehicle goes on with the map it has."""


class PushChannel:
    """One connection. `exchange` sends a position and waits until the server has acknowledged it, so that what the map
    says is what the server knew there."""

    def __init__(self, server_url: str, api_key: str | None, *, timeout_s: float = 5.0) -> None:
        headers = {"Authorization": f"Bearer {api_key}"} if api_key else {}
        self._timeout_s = timeout_s
        self._position_seq = 0
        self._open = ExitStack()
        try:
            connection = connect(
                _events_url(server_url),
                subprotocols=[Subprotocol(SUBPROTOCOL)],
                additional_headers=headers,
                open_timeout=timeout_s,
                close_timeout=timeout_s,
                compression=None,
                max_size=MAX_MESSAGE_BYTES,
            )
            self._connection: ClientConnection = self._open.enter_context(connection)
        except (OSError, InvalidHandshake, InvalidURI) as error:
            raise PushError(f"no push channel to {server_url}: {error}") from error

    def exchange(self, position: LatLon) -> list[ServerMessage]:
        """Say where the car is; returns all that the server sent up to its acknowledgement."""
        self._position_seq += 1
        message = Position(position_seq=self._position_seq, position=position, radius_m=AREA_RADIUS_M)
        try:
            self._connection.send(message.model_dump_json())
            return list(self._until_acknowledged(time.monotonic() + self._timeout_s))
        except TimeoutError as error:
            raise PushError(f"the position was not acknowledged within {self._timeout_s} s") from error
        except (ConnectionClosed, OSError) as error:
            raise PushError(f"the push channel broke: {error}") from error
        except ValidationError as error:
            raise PushError("the server sent a message that is not of this contract") from error

    def _until_acknowledged(self, deadline_s: float) -> Iterator[ServerMessage]:
        while True:
            remaining_s = deadline_s - time.monotonic()
            if remaining_s <= 0:
                raise TimeoutError
            frame = self._connection.recv(timeout=remaining_s)
            message = server_message.validate_json(frame)
            yield message
            if isinstance(message, Snapshot | Moved) and message.position_seq >= self._position_seq:
                return

    def close(self) -> None:
        """Say good-bye."""
        self._open.close()


def _events_url(server_url: str) -> str:
    parts = urlsplit(server_url)
    scheme = "wss" if parts.scheme == "https" else "ws"
    return urlunsplit((scheme, parts.netloc, parts.path.rstrip("/") + "/v1/events", "", ""))
