"""Settings, from the environment (prefix HEADSUP_); contradictions are refused on load, never mended."""

from __future__ import annotations

import ipaddress
from typing import Annotated, Literal

from pydantic import Field, SecretStr, field_validator
from pydantic_settings import BaseSettings, SettingsConfigDict
from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError

from server.policy import PolicyName

_DRIVERS = ("sqlite+aiosqlite", "postgresql+asyncpg")
# 32 characters of base64 are 192 bits: nothing to guess, and SHA-256 without a salt is safe to store.
_LEAST_KEY_LENGTH = 32


class Settings(BaseSettings):
    """What an operator may set. Every default works on a laptop."""

    model_config = SettingsConfigDict(env_prefix="HEADSUP_", frozen=True, allow_inf_nan=False)

    database_url: str = "sqlite+aiosqlite:///headsup.sqlite3"
    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65_535)] = 8000
    bootstrap_operator_key: SecretStr | None = None
    policy: PolicyName = "cooperation"
    write_deadline_s: Annotated[float, Field(gt=0, le=60, description="how long one request's writes are retried")] = 5
    cache_mib: Annotated[int, Field(ge=1, le=1 << 20, description="features kept in memory for nearby queries")] = 256
    log_level: Literal["debug", "info", "warning", "error"] = "info"

    @field_validator("database_url")
    @classmethod
    def _is_supported(cls, value: str) -> str:
        try:
            url = make_url(value)
        except ArgumentError:
            raise ValueError("not a database URL") from None
        if url.drivername not in _DRIVERS:
            raise ValueError(f"unsupported database {url.drivername!r}: use {' or '.join(_DRIVERS)}")
        if url.drivername == _DRIVERS[0] and url.database in (None, "", ":memory:"):
            raise ValueError("a database in memory is lost at once: name a file, sqlite+aiosqlite:///PATH")
        return value

    @field_validator("bootstrap_operator_key")
    @classmethod
    def _is_strong(cls, value: SecretStr | None) -> SecretStr | None:
        if value is not None and len(value.get_secret_value()) < _LEAST_KEY_LENGTH:
            raise ValueError(f"shorter than {_LEAST_KEY_LENGTH} characters: make one with `openssl rand -base64 33`")
        return value

    @property
    def listens_beyond_loopback(self) -> bool:
        """Whether other machines could reach the server at `host`."""
        if self.host == "localhost":
            return False
        try:
            return not ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return True
