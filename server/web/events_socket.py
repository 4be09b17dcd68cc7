"""`WebSocket /v1/events`: the edge between a vehicle's connection and its subscription."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import AsyncExitStack, suppress
from functools import partial

from fastapi import WebSocket
from fastapi.websockets import WebSocketDisconnect
from pydantic import ValidationError
from starlette.websockets import WebSocketState

from contract.events import SUBPROTOCOL, Position, ServerMessage
from server.errors import ServiceError, UnauthenticatedError, problem_of
from server.push.stream import Subscription
from server.trust.keys import Caller, Keys
from server.web.dependencies import Parts

_BAD_MESSAGE, _KEY_REVOKED, _WRONG_VERSION, _TRY_AGAIN_LATER = 4400, 4401, 4426, 1013
# A revoked key is cut off within this time.
_KEY_CHECK_INTERVAL_S = 30.0
# Each costs some 20 us to read: who sends more while one waits is read no further until it is due.
_MOST_OVERTAKEN = 200


async def serve_events(socket: WebSocket, parts: Parts) -> None:
    """Serve one connection until it ends.

    Refuses with 401, 403 or 429 before accepting, closes with 4400, 4401 or 4426 after.
    """
    async with AsyncExitStack() as held:
        try:
            caller = await parts.admission.caller(socket)
            parts.admission.must_be_no_strange_page(socket)
            held.enter_context(parts.admission.socket(caller))
        except ServiceError as error:
            await socket.send_denial_response(problem_of(error))
            return
        if SUBPROTOCOL not in socket.scope["subprotocols"]:
            await socket.accept()
            await socket.close(_WRONG_VERSION, f"subprotocol {SUBPROTOCOL} is needed")
            return
        await socket.accept(subprotocol=SUBPROTOCOL)
        await _converse(socket, parts, caller)


async def _converse(socket: WebSocket, parts: Parts, caller: Caller) -> None:
    hub = parts.hub

    async def send(message: ServerMessage) -> None:
        await socket.send_text(message.model_dump_json())
        hub.counts.sent += 1

    async def receive() -> None:
        while True:
            text = await _newest(socket, partial(parts.admission.position_wait_s, caller))
            subscription.move(Position.model_validate_json(text))

    subscription = Subscription(parts.relay.near, send)
    hub.add(subscription)
    tasks = {
        asyncio.create_task(receive()),
        asyncio.create_task(subscription.run()),
        asyncio.create_task(_watch_key(parts.keys, socket.headers.get("authorization"))),
    }
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        hub.remove(subscription)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    await _close(socket, next(iter(done)))


async def _newest(socket: WebSocket, wait_s: Callable[[], float]) -> str:
    """The next message; when it is not due yet, the newest of those that come until one is."""
    text, overtaken = await socket.receive_text(), 0
    while pause_s := wait_s():
        with suppress(TimeoutError):
            async with asyncio.timeout(pause_s):
                while overtaken < _MOST_OVERTAKEN:
                    text, overtaken = await socket.receive_text(), overtaken + 1
                await asyncio.sleep(pause_s)
    return text


async def _watch_key(keys: Keys, authorization: str | None) -> None:
    while True:
        await asyncio.sleep(_KEY_CHECK_INTERVAL_S)
        await keys.looked_up(authorization)


async def _close(socket: WebSocket, ended: asyncio.Task[None]) -> None:
    """Close with the code that belongs to what ended the conversation."""
    error = ended.exception()
    if socket.client_state is not WebSocketState.CONNECTED or isinstance(error, WebSocketDisconnect):
        return
    if isinstance(error, ValidationError | KeyError):
        await socket.close(_BAD_MESSAGE, "a message was not a position of the contract")
    elif isinstance(error, UnauthenticatedError):
        await socket.close(_KEY_REVOKED, "the key was revoked")
    else:
        await socket.close(_TRY_AGAIN_LATER, "try again")
        # A database that is away is no fault of the server's own.
        if error is not None and not isinstance(error, ServiceError):
            raise error
