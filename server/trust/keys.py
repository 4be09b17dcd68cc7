"""API keys: made once, stored hashed, checked on every request; and the witness behind a key."""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import secrets
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from uuid import UUID, uuid4

from pydantic import SecretStr
from sqlalchemy import RowMapping, select, update

from server.errors import ForbiddenError, UnauthenticatedError
from server.storage.database import Database
from server.storage.tables import api_key
from server.trust.key_owners import KeyOwners

_OPEN, _BOOTSTRAP = "open", "bootstrap"
# A revoked key is refused within the first; a server that was open asks for keys within the second.
_KEY_BELIEVED_S, _OPEN_BELIEVED_S = 15.0, 1.0
# Only valid keys are remembered; a fleet of this size fits.
_REMEMBERED_HEADERS = 100_000
# One key can be written with any number of spaces, and each way would be remembered.
_LONGEST_HEADER = 512


class Role(StrEnum):
    """What a key may do: everyone reads, vehicles and operators post."""

    VEHICLE = "vehicle"
    READER = "reader"
    OPERATOR = "operator"


@dataclass(frozen=True, slots=True)
class Caller:
    """Who sent a request."""

    key_id: str
    role: Role

    @property
    def is_anonymous(self) -> bool:
        """Whether the server runs open, without keys."""
        return self.key_id == _OPEN

    def must_be_able_to_post(self) -> None:
        """Refuse a reader."""
        if self.role is Role.READER:
            raise ForbiddenError("a key of role reader may not post observations: use one of role vehicle")


def witness_name(caller: Caller, pseudonym: str, secret: str) -> str:
    """Keyed hash that stands for the caller; without keys, for the pseudonym that the report carries."""
    who = f"pseudonym:{pseudonym}" if caller.is_anonymous else f"key:{caller.key_id}"
    return hmac.new(secret.encode(), who.encode(), hashlib.sha256).hexdigest()[:32]


@dataclass(frozen=True, slots=True)
class _Remembered:
    caller: Caller
    until_s: float


class Keys:
    """The keys of a database, and the one from the settings."""

    def __init__(self, database: Database, bootstrap: SecretStr | None) -> None:
        self._database = database
        self._owners = KeyOwners(database)
        self._remembered: dict[str | None, _Remembered] = {}
        self._some_exist = bootstrap is not None
        self._asked: asyncio.Task[bool] | None = None
        self._bootstrap_sha256 = None if bootstrap is None else _sha256(bootstrap.get_secret_value())

    def remembered(self, authorization: str | None) -> Caller | None:
        """Who an `Authorization` header stands for, if the database was asked within the last seconds."""
        remembered = self._remembered.get(authorization)
        if remembered is not None and time.monotonic() < remembered.until_s:
            return remembered.caller
        return None

    async def caller(self, authorization: str | None) -> Caller:
        """Who an `Authorization` header stands for, as the database says; it is believed for some seconds."""
        try:
            caller = await self.looked_up(authorization)
        except UnauthenticatedError:
            self._remembered.pop(authorization, None)
            raise
        if len(self._remembered) >= _REMEMBERED_HEADERS:
            self._remembered.clear()
        believed_s = _OPEN_BELIEVED_S if caller.is_anonymous else _KEY_BELIEVED_S
        self._remembered[authorization] = _Remembered(caller, time.monotonic() + believed_s)
        return caller

    async def looked_up(self, authorization: str | None) -> Caller:
        """The same as the database says it now."""
        if authorization is None:
            return await self._anonymous()
        scheme, _, key = authorization.partition(" ")
        if scheme.lower() != "bearer" or not key.strip() or len(authorization) > _LONGEST_HEADER:
            raise UnauthenticatedError("send `Authorization: Bearer KEY`")
        return await self._owner(_sha256(key.strip()))

    async def exist(self) -> bool:
        """Whether any key was ever made; from then on nobody is served without one."""
        if not self._some_exist:
            # All who wait for the answer share it: hundreds of requests may come at once.
            if self._asked is None or self._asked.done():
                self._asked = asyncio.create_task(self._any_in_database())
            self._some_exist = await asyncio.shield(self._asked)
        return self._some_exist

    async def create(self, role: Role, name: str) -> str:
        """Make a key; it is returned here and never again."""
        key = f"hu_{secrets.token_urlsafe(32)}"
        values = {"id": uuid4(), "name": name, "role": role.value, "sha256": _sha256(key), "created_at": _now()}
        async with self._database.write() as connection:
            await connection.execute(api_key.insert().values(values))
        return key

    async def all(self) -> Sequence[RowMapping]:
        """Every key's id, name, role, created and revoked, oldest first."""
        columns = (api_key.c.id, api_key.c.name, api_key.c.role, api_key.c.created_at, api_key.c.revoked_at)
        async with self._database.read() as connection:
            return (await connection.execute(select(*columns).order_by(api_key.c.created_at))).mappings().all()

    async def revoke(self, identifier: UUID) -> bool:
        """Revoke a key; False if there is none of that id, or it is revoked already."""
        valid = (api_key.c.id == identifier) & api_key.c.revoked_at.is_(None)
        async with self._database.write() as connection:
            result = await connection.execute(update(api_key).where(valid).values(revoked_at=_now()))
        return result.rowcount > 0

    async def _any_in_database(self) -> bool:
        async with self._database.read() as connection:
            # No key is ever deleted.
            return (await connection.execute(select(api_key.c.id).limit(1))).first() is not None

    async def _anonymous(self) -> Caller:
        if await self.exist():
            raise UnauthenticatedError("a key is needed: send `Authorization: Bearer KEY`")
        return Caller(_OPEN, Role.OPERATOR)

    async def _owner(self, sha256: str) -> Caller:
        if self._bootstrap_sha256 is not None and hmac.compare_digest(sha256, self._bootstrap_sha256):
            return Caller(_BOOTSTRAP, Role.OPERATOR)
        owner = await self._owners.of(sha256)
        if owner is None:
            raise UnauthenticatedError("the key is unknown or revoked")
        key_id, role = owner
        return Caller(key_id, Role(role))


def _sha256(key: str) -> str:
    return hashlib.sha256(key.encode()).hexdigest()


def _now() -> datetime:
    return datetime.now(UTC)
