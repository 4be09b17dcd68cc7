"""Who is let in, and how often: keys, rates of each key, unknown keys of each address, sockets of each key."""

from __future__ import annotations

import ipaddress
import re
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from starlette.requests import HTTPConnection
from starlette.types import Scope

from server.errors import ForbiddenError, ServiceError, TooManyRequestsError, UnauthenticatedError
from server.settings import Settings
from server.trust.keys import Caller, Keys, Role
from server.trust.rate_limit import RateLimit
from server.web.request_context import CURRENT, note_key

# Attackers with more addresses than this push each other out, which costs them nothing and us little.
_MOST_ADDRESSES = 10_000
# An allocation of IPv6 is a /64: counting single addresses would count nothing.
_IPV6_PREFIX = 64
_SOCKET_WAIT_S = 10.0
_HOST = re.compile(r"(?:\[(?P<literal>[^\[\]]*)\]|(?P<name>[^:\[\]]*))(?::\d*)?")
# Where a request keeps it, since one may go through two routes.
_CALLER = "headsup.caller"


class Admission:
    """Answers for every request who sent it, or refuses it. Rates are of this process, and not the anonymous'."""

    def __init__(self, keys: Keys, settings: Settings) -> None:
        self._keys = keys
        burst_s = settings.rate_burst_s
        rates = {
            Role.VEHICLE: settings.vehicle_rate_hz,
            Role.READER: settings.reader_rate_hz,
            Role.OPERATOR: settings.operator_rate_hz,
        }
        self._requests = {role: RateLimit(rate_hz, max(1.0, rate_hz * burst_s)) for role, rate_hz in rates.items()}
        self._reports = RateLimit(settings.report_rate_hz, settings.report_rate_hz * burst_s)
        per_minute = settings.failed_keys_per_minute
        self._failures = RateLimit(per_minute / 60, max(1.0, per_minute), _MOST_ADDRESSES)
        self._sockets_per_key, self._origins = settings.sockets_per_key, frozenset(settings.cors_origins)
        self._sockets: Counter[str] = Counter()
        self.refused: Counter[str] = Counter()
        """How often something was refused, by what was too many."""

    @property
    def sockets(self) -> int:
        """Open WebSockets."""
        return self._sockets.total()

    async def caller(self, connection: HTTPConnection) -> Caller:
        """Who sent a request, which counts once. Raises `UnauthenticatedError` or `TooManyRequestsError`."""
        known: Caller | ServiceError | None = connection.scope.get(_CALLER)
        if isinstance(known, ServiceError):
            raise known
        if known is not None:
            return known
        try:
            caller = connection.scope[_CALLER] = await self._counted(connection)
        except ServiceError as error:
            connection.scope[_CALLER] = error
            raise
        return caller

    def is_known(self, scope: Scope, authorization: bytes | None) -> bool:
        """Count a request as `caller` does, if nobody has to be asked and nothing is refused; else do nothing."""
        if authorization is None:
            return False
        caller = self._keys.remembered(authorization.decode("latin-1"))
        if caller is None or self._requests[caller.role].take(caller.key_id, time.monotonic()):
            return False
        scope[_CALLER] = caller
        note_key(caller.key_id)
        return True

    async def _counted(self, connection: HTTPConnection) -> Caller:
        authorization = connection.headers.get("authorization")
        caller = self._keys.remembered(authorization)
        if caller is None:
            caller = await self._looked_up(connection, authorization)
        note_key(caller.key_id)
        if caller.is_anonymous:
            _must_be_of_this_machine(connection)
        elif wait_s := self._requests[caller.role].take(caller.key_id, time.monotonic()):
            raise self._refusal("requests", wait_s)
        return caller

    def reports(self, caller: Caller, number: int) -> None:
        """Take a number of reports, or raise `TooManyRequestsError`."""
        if caller.is_anonymous:
            return
        if wait_s := self._reports.take(caller.key_id, time.monotonic(), number):
            raise self._refusal("reports", wait_s)

    def position_wait_s(self, caller: Caller) -> float:
        """Take a message on a socket, which counts like a request; the seconds to wait when it is not due, else 0."""
        if caller.is_anonymous:
            return 0.0
        return self._requests[caller.role].take(caller.key_id, time.monotonic())

    @contextmanager
    def socket(self, caller: Caller) -> Iterator[None]:
        """Hold one of the caller's sockets, or raise `TooManyRequestsError`."""
        if self._sockets[caller.key_id] >= self._sockets_per_key and not caller.is_anonymous:
            raise self._refusal("sockets", _SOCKET_WAIT_S)
        self._sockets[caller.key_id] += 1
        try:
            yield
        finally:
            self._sockets[caller.key_id] -= 1
            if not self._sockets[caller.key_id]:
                del self._sockets[caller.key_id]

    def must_be_no_strange_page(self, connection: HTTPConnection) -> None:
        """Refuse the socket of another origin's web page: browsers ask nobody before they open one (RFC 6455, 10.2)."""
        origin = connection.headers.get("origin")
        host = connection.headers.get("host", "")
        if origin is not None and origin not in {*self._origins, f"http://{host}", f"https://{host}"}:
            raise ForbiddenError("pages of this origin may not connect: see HEADSUP_CORS_ORIGINS")

    async def _looked_up(self, connection: HTTPConnection, authorization: str | None) -> Caller:
        try:
            return await self._keys.caller(authorization)
        except UnauthenticatedError:
            # Only who fails counts and waits: good keys share the address with an attacker (a carrier's NAT, a proxy).
            if wait_s := self._failures.take(_network(connection), time.monotonic()):
                raise self._refusal("failed-keys", wait_s) from None
            raise

    def _refusal(self, what: str, wait_s: float) -> TooManyRequestsError:
        self.refused[what] += 1
        return TooManyRequestsError(f"{_TOO_MANY[what]}; try again after `Retry-After` seconds", wait_s)


_TOO_MANY = {
    "requests": "this key sends too many requests",
    "reports": "this key sends too many reports",
    "sockets": "this key holds too many WebSockets",
    "failed-keys": "too many unknown keys came from this address",
}


def _must_be_of_this_machine(connection: HTTPConnection) -> None:
    """A server without keys listens on loopback; a proxy there would bring it the whole world.

    So would a web page whose host name is made to lead to this machine (DNS rebinding).
    """
    context = CURRENT.get()
    if context is not None and context.is_forwarded:
        raise UnauthenticatedError("a server without keys serves its own machine only, not through a proxy: make a key")
    if not _is_loopback(connection.headers.get("host", "localhost")):
        raise UnauthenticatedError("a server without keys is asked as localhost or 127.0.0.1 only: make a key")


def _is_loopback(host: str) -> bool:
    """Whether a `Host` (RFC 9110, 7.2) names this machine."""
    known = _HOST.fullmatch(host)
    if known is None:
        return False
    name = known["literal"] or known["name"]
    try:
        return ipaddress.ip_address(name).is_loopback
    except ValueError:
        return name.lower() == "localhost"


def _network(connection: HTTPConnection) -> str:
    host = "" if connection.client is None else connection.client.host
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host
    return str(ipaddress.ip_network((address, _IPV6_PREFIX), strict=False)) if address.version == 6 else host
