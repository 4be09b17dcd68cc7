"""The kept connection of nearby queries outlives what happens to the database."""

from __future__ import annotations

import asyncio

import pytest
from sqlalchemy.ext.asyncio import create_async_engine

from server.errors import UnavailableError
from server.storage.driver import Driver
from tests.integration.processes import killable_postgres


@pytest.mark.soak
async def test_a_kept_connection_is_replaced_after_whatever_the_database_went_through() -> None:
    with killable_postgres() as postgres:
        engine = create_async_engine(postgres.fresh_url())
        driver = Driver(engine, deadline_s=1)
        try:
            assert await driver.fetch("SELECT $1::int8", 1) == [(1,)]
            postgres.kill()
            with pytest.raises(UnavailableError):
                await driver.fetch("SELECT $1::int8", 2)
            await asyncio.to_thread(postgres.start)
            assert await driver.fetch("SELECT $1::int8", 3) == [(3,)]
            postgres.kill()
            await asyncio.to_thread(postgres.start)
            assert await driver.fetch("SELECT $1::int8", 4) == [(4,)], "lost unnoticed between two statements"
            with postgres.frozen(), pytest.raises(UnavailableError):
                await driver.fetch("SELECT $1::int8", 5)
            assert await driver.fetch("SELECT $1::int8", 6) == [(6,)]
        finally:
            await driver.close()
            await engine.dispose()
