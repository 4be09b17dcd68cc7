"""The way to the server and back: reports through the outbox by HTTP, events by WebSocket. Failing is normal here."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType

import httpx

from contract.events import ServerMessage
from contract.geometry import LatLon
from contract.observation import ObservationReport, ReportResult
from vehicle_client.outbox import Outbox, deliver
from vehicle_client.push import PushChannel, PushError

TIMEOUT_S = 5.0
"""A server that takes longer is treated as away; the report waits in the outbox."""


class ServerLink:
    """One vehicle's connection. Without the server it keeps what is to be sent and hears nothing."""

    def __init__(self, server_url: str, api_key: str | None, outbox_path: Path) -> None:
        self._server_url = server_url
        self._api_key = api_key
        headers = {"Authorization": f"Bearer {api_key}"} if api_key else {}
        self._client = httpx.Client(base_url=server_url, headers=headers, timeout=TIMEOUT_S)
        self._outbox = Outbox(outbox_path)
        self._push: PushChannel | None = None

    def __enter__(self) -> ServerLink:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._drop_push()
        self._client.close()
        self._outbox.close()

    @property
    def connected(self) -> bool:
        """Whether the push channel stood when it was last used."""
        return self._push is not None

    def hear(self, position: LatLon) -> list[ServerMessage]:
        """Tell the server where the car is; what it says of the area. Empty when it cannot be reached."""
        try:
            if self._push is None:
                self._push = PushChannel(self._server_url, self._api_key, timeout_s=TIMEOUT_S)
            return self._push.exchange(position)
        except PushError:
            self._drop_push()
            return []

    def put(self, report: ObservationReport) -> None:
        """Keep a report until the server has answered it."""
        self._outbox.put(report)

    def deliver(self) -> list[ReportResult]:
        """Send what waits; the answers. Raises `OutboxError` when the server refuses this vehicle."""
        return deliver(self._outbox, self._client)

    def _drop_push(self) -> None:
        if self._push is not None:
            self._push.close()
            self._push = None
