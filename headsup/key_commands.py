"""`headsup keys`: who may use the server."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from datetime import datetime
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated
from uuid import UUID

import typer

from headsup.server_settings import refuse, with_database

if TYPE_CHECKING:
    from server.storage.database import Database
    from server.trust.keys import Keys

keys_app = typer.Typer(help="API keys of vehicles, readers and operators.", no_args_is_help=True)
_NAME_LENGTH = 64


class KeyRole(StrEnum):
    """What a key may do."""

    VEHICLE = "vehicle"
    READER = "reader"
    OPERATOR = "operator"


@keys_app.command("create")
def create_key(
    role: Annotated[KeyRole, typer.Option(help="vehicle posts and reads, reader only reads, operator does all.")],
    name: Annotated[str, typer.Option(help="Whose key it is, for the list; at most 64 characters.")],
) -> None:
    """Make a key and print it, once and alone, so that a script can capture it.

    Example:

        KEY=$(headsup keys create --role vehicle --name ego1)
    """
    from server.trust.keys import Role

    # A line of the list is a key's; what turns text around would show another name.
    if not (name.strip() and name.isprintable() and len(name) <= _NAME_LENGTH):
        raise typer.BadParameter(f"1 to {_NAME_LENGTH} printable characters", param_hint="--name")

    async def create(keys: Keys) -> None:
        typer.echo(await keys.create(Role(role.value), name))

    _with_keys(create, makes=True)


@keys_app.command("list")
def list_keys() -> None:
    """List all keys: id, role, created, revoked (times in UTC), name.

    Example:

        headsup keys list
    """

    async def show(keys: Keys) -> None:
        for key in await keys.all():
            revoked = f"revoked {_minute(key['revoked_at'])}" if key["revoked_at"] else "valid"
            typer.echo(f"{key['id']}  {key['role']:8}  {_minute(key['created_at'])}  {revoked}  {key['name']}")

    _with_keys(show)


@keys_app.command("revoke")
def revoke_key(key_id: Annotated[UUID, typer.Argument(help="The key's id, from `headsup keys list`.")]) -> None:
    """Revoke a key; connections made with it are cut within half a minute. Exits with 1 when it is revoked already.

    Example:

        headsup keys revoke 0b7f5c9e-1b1f-4f0e-9d6a-0c9c3d1f2a11
    """

    async def revoke(keys: Keys) -> None:
        if await keys.revoke(key_id):
            return
        for key in await keys.all():
            if key["id"] == key_id:
                refuse(f"the key {key_id} is revoked already, since {_minute(key['revoked_at'])}")
        refuse(f"there is no key {key_id}: see `headsup keys list`")

    _with_keys(revoke)


def _minute(moment: datetime) -> str:
    return f"{moment:%Y-%m-%dT%H:%MZ}"


def _with_keys(work: Callable[[Keys], Awaitable[None]], *, makes: bool = False) -> None:
    """Run `work` on the keys of a database whose schema is right; a fresh file of SQLite gets it."""

    async def prepared(database: Database) -> None:
        from server.storage import schema
        from server.trust.keys import Keys

        await schema.prepare(database)
        await work(Keys(database, None))

    with_database(prepared, makes=makes)
