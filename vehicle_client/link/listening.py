"""What the server says around the car: by WebSocket, and by polling where that does not pass."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from http import HTTPStatus
from random import Random

from contract.geometry import LatLon
from vehicle_client.area import Heard
from vehicle_client.link.back_off import delay_s
from vehicle_client.link.http_asking import KEY_NEEDED, client_for
from vehicle_client.link.polling import Poller, PollError
from vehicle_client.link.push import PushChannel, PushError

_LOG = logging.getLogger(__name__)

POLL_AFTER = 3
"""Failures of the WebSocket in a row after which it is taken not to pass: a server that restarts is back before."""

POLL_EVERY_S = 3.0
"""At 130 km/h the car drives 110 m meanwhile, of the 1,000 m that are asked for."""

PUSH_AGAIN_S = 300.0
"""How often the WebSocket is tried again while polling works, or the key is refused."""

_REFUSALS = (HTTPStatus.UNAUTHORIZED, HTTPStatus.FORBIDDEN)

Clock = Callable[[], float]


class Listener:
    """Call `hear` about once a second. Nothing is raised; `clock` is any that never goes back, in seconds."""

    def __init__(
        self,
        server_url: str,
        api_key: str | None,
        *,
        timeout_s: float,
        jitter: Random,
        clock: Clock = time.monotonic,
    ) -> None:
        self._server_url, self._api_key, self._timeout_s = server_url, api_key, timeout_s
        self._jitter, self._clock = jitter, clock
        self._client = client_for(server_url, api_key, timeout_s)
        self._poller = Poller(self._client)
        self._push: PushChannel | None = None
        self._failures = self._poll_failures = 0
        self._is_closed = False
        self._push_at_s = self._poll_at_s = clock()
        self.is_polling = False
        """Whether the last question was answered."""
        self.refusal: str | None = None
        """Why the server tells this vehicle nothing before somebody does something; None while it does."""

    @property
    def is_pushed(self) -> bool:
        """Whether the WebSocket stood when it was last used."""
        return self._push is not None

    def hear(self, position: LatLon, heading_rad: float | None = None) -> list[Heard]:
        """What the server says of the area around a place; empty when it cannot be reached or nothing is due."""
        if self._push is not None or self._clock() >= self._push_at_s:
            heard = self._exchanged(position)
            if heard is not None:
                return heard
        if self._failures >= POLL_AFTER and self._clock() >= self._poll_at_s and not self._is_closed:
            return self._polled(position, heading_rad)
        return []

    def close(self) -> None:
        """Close all connections for good; also from another thread, while one is being used."""
        self._is_closed = True
        self._drop_push()
        self._client.close()

    def _exchanged(self, position: LatLon) -> list[Heard] | None:
        try:
            if self._push is None:
                self._push = PushChannel(self._server_url, self._api_key, timeout_s=self._timeout_s)
            if self._is_closed:
                raise PushError("the listener was closed meanwhile")
            heard = self._push.exchange(position)
        except PushError as error:
            self._drop_push()
            self._put_off_push(error)
            return None
        self._failures, self.is_polling = 0, False
        self._note_refusal(None)
        return heard

    def _put_off_push(self, error: PushError) -> None:
        self._failures += 1
        _LOG.info("the WebSocket fails: %s", error)
        if error.status in _REFUSALS:
            self._note_refusal(f"{error}; {KEY_NEEDED}")
        rarely = self.is_polling or error.status in _REFUSALS
        wait_s = PUSH_AGAIN_S if rarely else error.wait_s
        self._push_at_s = self._clock() + delay_s(self._failures, self._jitter.random(), wait_s)

    def _polled(self, position: LatLon, heading_rad: float | None) -> list[Heard]:
        try:
            surveyed = self._poller.poll(position, heading_rad)
        except PollError as error:
            self.is_polling = False
            self._poll_failures += 1
            _LOG.info("polling fails: %s", error)
            self._note_refusal(f"{error}; {KEY_NEEDED}" if error.status in _REFUSALS else self.refusal)
            self._poll_at_s = self._clock() + delay_s(self._poll_failures, self._jitter.random())
            return []
        if not self.is_polling:
            _LOG.warning("no WebSocket passes: the server is asked every %.0f s instead", POLL_EVERY_S)
        self.is_polling, self._poll_failures = True, 0
        self._note_refusal(None)
        self._poll_at_s = self._clock() + POLL_EVERY_S
        return [surveyed]

    def _note_refusal(self, refusal: str | None) -> None:
        if refusal != self.refusal and refusal is not None:
            _LOG.error("the server tells this vehicle nothing: %s", refusal)
        self.refusal = refusal

    def _drop_push(self) -> None:
        push, self._push = self._push, None
        if push is not None:
            push.close()
