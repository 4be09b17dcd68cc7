"""What must hold before the server listens: the schema is this version's, and nobody beyond loopback needs no key."""

from __future__ import annotations

import logging

from server import schema
from server.database import Database
from server.errors import UnguardedError
from server.keys import Keys
from server.settings import Settings

_LOG = logging.getLogger(__name__)


async def make_ready(database: Database, keys: Keys, settings: Settings) -> None:
    """Check the schema and the guard; raises `SchemaOutOfDateError` or `UnguardedError`."""
    await schema.prepare(database)
    if await keys.exist():
        return
    if settings.listens_beyond_loopback:
        raise UnguardedError(
            f"refusing to listen on {settings.host} without any API key: make one with `headsup keys create "
            "--role operator --name NAME`, or set HEADSUP_BOOTSTRAP_OPERATOR_KEY"
        )
    _LOG.warning("running open: there is no API key, so everybody on this machine may read and post")


async def preflight(settings: Settings) -> None:
    """The same before any server exists, so that a refusal is one line and not a failed start."""
    database = Database.open(settings.database_url)
    try:
        await make_ready(database, Keys(database, settings.bootstrap_operator_key), settings)
    finally:
        await database.close()
