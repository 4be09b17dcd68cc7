"""What must hold before the server listens: the schema is right, writes work, beyond loopback everybody needs a key."""

from __future__ import annotations

from server.errors import UnguardedError
from server.settings import Settings
from server.storage import schema
from server.storage.database import Database
from server.trust.keys import Keys


async def make_ready(database: Database, keys: Keys, settings: Settings) -> bool:
    """Check schema, storage and guard; whether there are keys.

    Raises `SchemaOutOfDateError`, `UnavailableError` or `UnguardedError`.
    """
    await schema.prepare(database)
    await database.probe()
    has_keys = await keys.exist()
    if not has_keys and settings.listens_beyond_loopback:
        raise UnguardedError(
            f"refusing to listen on {settings.host} without any API key: make one with `headsup keys create "
            "--role operator --name NAME`, or set HEADSUP_BOOTSTRAP_OPERATOR_KEY"
        )
    return has_keys


async def preflight(settings: Settings) -> None:
    """The same before any server exists, so that a refusal is one line and not a failed start."""
    database = Database.open(settings.database_url)
    try:
        await make_ready(database, Keys(database, settings.bootstrap_operator_key), settings)
    finally:
        await database.close()
