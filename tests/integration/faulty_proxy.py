"""A TCP proxy that does to HTTP requests what networks do, drawn from a seed; WebSockets it cuts now and then."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections import Counter
from contextlib import suppress
from random import Random

LATE_S = 0.7
"""Beyond the time-out of the client under test."""

SLOW_S = 0.15
"""A link that is slow, and still fast enough."""

FAULTS = (
    "refused",
    "reset before",
    "reset after",
    "half an answer",
    "answer lost",
    "late",
    "slow",
    "twice",
    "503",
    "429",
    "garbage",
    "login page",
)
_ANSWERS = {
    "503": b"HTTP/1.1 503 Service Unavailable\r\nRetry-After: 1\r\nContent-Length: 0\r\n\r\n",
    "429": b"HTTP/1.1 429 Too Many Requests\r\nRetry-After: 2\r\nContent-Length: 4\r\n\r\nslow",
    "garbage": b"\x16\x03\x01\x00\xff nothing that anybody speaks\r\n\r\n",
    "login page": b"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\nContent-Length: 14\r\n\r\n<html>Welcome!",
}


class FaultyProxy:
    """Listens on a port of its own and forwards to `server_port`; a share `faults` of the requests fares badly."""

    def __init__(self, server_port: int, random: Random, faults: float) -> None:
        self.server_port, self.faults = server_port, faults
        self.done: Counter[str] = Counter()
        self._random, self._drawing = random, threading.Lock()
        self._deck: list[str] = []
        self._listening = socket.create_server(("127.0.0.1", 0))
        self._open: set[socket.socket] = set()
        self._thread = threading.Thread(target=self._accept, daemon=True)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self._listening.getsockname()[1]}"

    def __enter__(self) -> FaultyProxy:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._listening.shutdown(socket.SHUT_RDWR)
        self._listening.close()
        for connection in list(self._open):
            _cut(connection)

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listening.accept()
            except OSError:
                return
            self._open.add(client)
            threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _serve(self, client: socket.socket) -> None:
        try:
            with suppress(OSError), client:
                while request := _message(client):
                    if not self._answered(client, request):
                        return
        finally:
            self._open.discard(client)

    def _answered(self, client: socket.socket, request: bytes) -> bool:
        """Deal with one request; whether the connection goes on."""
        fault = self._drawn()
        if fault == "refused":
            return False
        if fault == "reset before":
            _reset(client)
            return False
        if fault in _ANSWERS:
            client.sendall(_ANSWERS[fault])
            return False
        if b"upgrade: websocket" in request.lower():
            self._pipe(client, request)
            return False
        if fault == "twice":
            self._asked(request)
        answer = self._asked(request)
        if not answer or fault == "answer lost":
            return False
        if fault == "reset after":
            _reset(client)
            return False
        time.sleep({"late": LATE_S, "slow": SLOW_S}.get(fault, 0.0))
        client.sendall(answer[: len(answer) // 2] if fault == "half an answer" else answer)
        return fault not in ("half an answer", "late")

    def _drawn(self) -> str:
        """The next fault: all of them in turn, in an order of chance, so that a short run has each."""
        with self._drawing:
            if not self._deck:
                self._deck = self._random.sample(FAULTS, len(FAULTS))
            fault = self._deck.pop() if self._random.random() < self.faults else "none"
            self.done[fault] += 1
        return fault

    def _asked(self, request: bytes) -> bytes:
        """The server's whole answer; nothing when it is away."""
        try:
            with socket.create_connection(("127.0.0.1", self.server_port), timeout=10) as server:
                server.sendall(request)
                return _message(server)
        except OSError:
            return b""

    def _pipe(self, client: socket.socket, request: bytes) -> None:
        """Both ways at once, cut after a while."""
        try:
            server = socket.create_connection(("127.0.0.1", self.server_port), timeout=10)
        except OSError:
            return
        self._open.add(server)
        server.sendall(request)
        back = threading.Thread(target=_copy, args=(server, client), daemon=True)
        back.start()
        if self.faults:
            cut = threading.Timer(self._random.uniform(0.05, 0.5), _cut, (client,))
            cut.daemon = True
            cut.start()
        _copy(client, server)
        back.join()
        self._open.discard(server)


def _message(connection: socket.socket) -> bytes:
    """A whole request or answer of HTTP/1.1; what came before the connection ended."""
    data = b""
    while b"\r\n\r\n" not in data:
        part = connection.recv(65_536)
        if not part:
            return data
        data += part
    head, _, body = data.partition(b"\r\n\r\n")
    lengths = [line.split(b":")[1] for line in head.lower().split(b"\r\n") if line.startswith(b"content-length:")]
    missing = int(lengths[0]) - len(body) if lengths else 0
    while missing > 0:
        part = connection.recv(65_536)
        if not part:
            return data
        data, missing = data + part, missing - len(part)
    return data


def _copy(source: socket.socket, sink: socket.socket) -> None:
    with suppress(OSError):
        while part := source.recv(65_536):
            sink.sendall(part)
    _cut(source)
    _cut(sink)


def _cut(connection: socket.socket) -> None:
    with suppress(OSError):
        connection.shutdown(socket.SHUT_RDWR)


def _reset(connection: socket.socket) -> None:
    """Close so that the other side gets RST instead of FIN."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    connection.close()
