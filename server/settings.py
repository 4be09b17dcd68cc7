"""Settings, from the environment (prefix HEADSUP_); contradictions are refused on load, never mended."""

from __future__ import annotations

import difflib
import ipaddress
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, SecretStr, field_validator, model_validator
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict
from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError

from contract.observation import MAX_REPORTS
from server.life.policy import PolicyName
from server.logs import LogFormat

PREFIX = "HEADSUP_"
# A folder of recordings for `headsup demo` and the tests, and a vehicle's key.
_NOT_OURS = frozenset({"HEADSUP_DATA", "HEADSUP_API_KEY"})
_DRIVERS = ("sqlite+aiosqlite", "postgresql+asyncpg")
# 32 characters of base64 are 192 bits: nothing to guess, and SHA-256 without a salt is safe to store.
_LEAST_KEY_LENGTH = 32
_Rate = Annotated[float, Field(gt=0, le=1e9)]
_Listed = Annotated[tuple[str, ...], NoDecode]


class PolicySettings(BaseSettings):
    """Which numbers the rule runs with."""

    model_config = SettingsConfigDict(env_prefix=PREFIX, frozen=True, allow_inf_nan=False)

    policy: PolicyName = "cooperation"
    policy_file: Path | None = None
    """TOML over the policy's numbers: `server.policy_file`."""


class Settings(PolicySettings):
    """What an operator may set. Every default works on a laptop."""

    database_url: str = "sqlite+aiosqlite:///headsup.sqlite3"
    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65_535)] = 8000
    bootstrap_operator_key: SecretStr | None = None

    retention_days: Annotated[int, Field(ge=7, le=36_500)] = 90
    """Not below a week: until then a report may be repeated. A quarter shows whether a repair has held."""

    write_deadline_s: Annotated[float, Field(gt=0, le=60, description="how long one request's writes are retried")] = 5
    cache_mib: Annotated[int, Field(ge=1, le=1 << 20, description="features kept in memory for nearby queries")] = 256

    vehicle_rate_hz: _Rate = 20
    """A vehicle asks once a second and reports once a minute; the rest is for those that poll, and for retries."""
    reader_rate_hz: _Rate = 50
    """A service that reads an area in pages."""
    operator_rate_hz: _Rate = 100
    """Scripts of the operator."""
    report_rate_hz: _Rate = 50
    """Reports of one key: a vehicle back from a week without coverage is done within minutes."""
    rate_burst_s: Annotated[float, Field(gt=0, le=3_600)] = 5
    """Any rate may be used up this long at once: a tunnel's length of silence."""
    failed_keys_per_minute: _Rate = 30
    """Of one address; keys cannot be guessed, but each one costs a query. Many vehicles may share an address."""
    sockets_per_key: Annotated[int, Field(ge=1)] = 8
    """A vehicle needs one, and a second while the network forgets the first; a control room has several screens."""
    max_connections: Annotated[int, Field(ge=1)] = 10_000
    """In all, beyond it 503: each takes a file and some 50 KiB."""

    trusted_proxies: _Listed = ()
    """Addresses or networks of proxies whose `X-Forwarded-For` and `X-Forwarded-Proto` are believed."""
    cors_origins: _Listed = ()
    """Origins of web pages that may read answers, as https://map.example."""
    metrics: Literal["operator", "loopback", "off"] = "operator"
    """Who may read /metrics: operator keys, or this machine without a key."""

    log_level: Literal["debug", "info", "warning", "error"] = "info"
    log_format: LogFormat = "text"
    log_requests: Literal["failed", "all"] = "failed"
    """A line for each request costs a tenth of answering it; failed ones and those above a second are always told."""

    drain_s: Annotated[float, Field(ge=0, le=300)] = 0
    """How long /readyz says 503 before a stopping server closes its door, so that a balancer looks elsewhere."""

    @field_validator("database_url")
    @classmethod
    def _is_supported(cls, value: str) -> str:
        try:
            url = make_url(value)
        except (ArgumentError, ValueError):
            # The error's own text may hold the password.
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

    @field_validator("trusted_proxies", "cors_origins", mode="before")
    @classmethod
    def _is_a_comma_list(cls, value: object) -> object:
        return tuple(part.strip() for part in value.split(",") if part.strip()) if isinstance(value, str) else value

    @field_validator("trusted_proxies")
    @classmethod
    def _are_networks(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for item in value:
            try:
                ipaddress.ip_network(item)
            except ValueError:
                raise ValueError(f"{item!r} is no address or network such as 10.0.0.0/8") from None
        return value

    @field_validator("cors_origins")
    @classmethod
    def _are_origins(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        for item in value:
            scheme, separator, host = item.partition("://")
            if scheme not in ("http", "https") or not separator or not host or "/" in host or "*" in host:
                raise ValueError(f"{item!r} is no origin such as https://map.example")
        return value

    @model_validator(mode="after")
    def _takes_a_whole_batch(self) -> Settings:
        if self.report_rate_hz * self.rate_burst_s < MAX_REPORTS:
            raise ValueError(
                f"HEADSUP_REPORT_RATE_HZ times HEADSUP_RATE_BURST_S must be at least {MAX_REPORTS}, the reports of "
                "one batch: a full one would never be taken"
            )
        return self

    @property
    def listens_beyond_loopback(self) -> bool:
        """Whether other machines could reach the server at `host`."""
        if self.host == "localhost":
            return False
        try:
            return not ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return True


def unknown_variables(environment: Iterable[str]) -> list[str]:
    """A line for each variable that looks like a setting and is none, with the nearest one there is."""
    known = [name.upper() for name in Settings.model_fields]
    lines = []
    for variable in sorted(environment):
        name = variable.upper().removeprefix(PREFIX)
        if variable.upper() in _NOT_OURS or name == variable.upper() or name in known:
            continue
        near = difflib.get_close_matches(name, known, 1)
        lines.append(f"{variable} is no setting" + (f": did you mean {PREFIX}{near[0]}?" if near else ""))
    return lines
