"""The operator's commands: `serve`, `keys`, `db`. The server is loaded inside them, so that `--help` is instant."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from datetime import datetime
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any, NoReturn
from uuid import UUID

import typer

from headsup.database_commands import backup_database, downgrade_database, show_status, upgrade_database
from headsup.log_commands import prune_log, replay_log

if TYPE_CHECKING:
    from server.life.policy import Policy
    from server.settings import Settings
    from server.storage.database import Database
    from server.trust.keys import Keys

keys_app = typer.Typer(help="API keys of vehicles, readers and operators.", no_args_is_help=True)
db_app = typer.Typer(help="The server's database.", no_args_is_help=True)
db_app.command("status")(show_status)
db_app.command("upgrade")(upgrade_database)
db_app.command("downgrade")(downgrade_database)
db_app.command("backup")(backup_database)
db_app.command("replay")(replay_log)
db_app.command("prune")(prune_log)
_NAME_LENGTH = 64


class KeyRole(StrEnum):
    """What a key may do."""

    VEHICLE = "vehicle"
    READER = "reader"
    OPERATOR = "operator"


def serve(
    host: Annotated[str | None, typer.Option(help="Address to listen on; HEADSUP_HOST, else 127.0.0.1.")] = None,
    port: Annotated[int | None, typer.Option(help="Port, 0 for a free one; HEADSUP_PORT, else 8000.")] = None,
    database_url: Annotated[str | None, typer.Option(help="HEADSUP_DATABASE_URL, else headsup.sqlite3 here.")] = None,
) -> None:
    """Run the obstacle service until it is interrupted.

    Settings come from the environment (HEADSUP_...), options win. A fresh SQLite file gets its tables; any other
    database must be brought up to date by `headsup db upgrade`. Prints `listening on http://HOST:PORT` when ready.
    SIGTERM ends it once the requests under way are answered.

    Examples:

        headsup serve

        headsup serve --port 0 --database-url sqlite+aiosqlite:////tmp/try.sqlite3

        HEADSUP_BOOTSTRAP_OPERATOR_KEY=$(openssl rand -base64 33) headsup serve --host 0.0.0.0
    """
    from server.errors import ServiceError, for_operators
    from server.running import run

    settings = serving_settings(host=host, port=port, database_url=database_url)
    try:
        exit_code = run(settings)
    except ServiceError as error:
        refuse(for_operators(error))
    raise typer.Exit(exit_code)


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

    _with_keys(create)


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


def settings_with(**options: Any) -> Settings:
    """Settings from the environment and the options given; exits with a line for each that cannot be used."""
    from server.settings import Settings

    given = {name: value for name, value in options.items() if value is not None}
    _refuse_faults(lambda: Settings(**given))
    return Settings(**given)


def serving_settings(**options: Any) -> Settings:
    """The same for a server, which also needs a policy: what is wrong with that is listed with the rest."""
    from server.policy_file import policy_of
    from server.settings import PolicySettings, Settings

    given = {name: value for name, value in options.items() if value is not None}
    _refuse_faults(lambda: Settings(**given), lambda: policy_of(PolicySettings()))
    return Settings(**given)


def policy_in_force() -> Policy:
    """The policy of the settings; exits with a line when its file cannot be used."""
    from server.policy_file import policy_of
    from server.settings import PolicySettings

    _refuse_faults(lambda: policy_of(PolicySettings()))
    return policy_of(PolicySettings())


def _refuse_faults(*makes: Callable[[], object]) -> None:
    """Make each, and exit with a line for every fault in any of them."""
    from pydantic import ValidationError

    from server.errors import ServiceError

    lines: list[str] = []
    for make in makes:
        try:
            make()
        except ValidationError as error:
            lines += map(_complaint, error.errors())
        except ServiceError as error:
            lines.append(str(error))
    if lines:
        refuse("\n".join(dict.fromkeys(lines)))


def _complaint(item: Mapping[str, Any]) -> str:
    message = str(item["msg"]).removeprefix("Value error, ")
    # What concerns several settings has no place.
    return f"HEADSUP_{str(item['loc'][0]).upper()}: {message}" if item["loc"] else message


def _with_keys(work: Callable[[Keys], Awaitable[None]]) -> None:
    """Run `work` on the keys of a database whose schema is right (a fresh SQLite file gets it)."""

    async def prepared(database: Database) -> None:
        from server.storage import schema
        from server.trust.keys import Keys

        await schema.prepare(database)
        await work(Keys(database, None))

    with_database(prepared)


def with_database(work: Callable[[Database], Awaitable[None]]) -> None:
    """Run `work` on the database of the settings; exits with a line when it is refused or the database fails."""
    from sqlalchemy.exc import SQLAlchemyError

    from server.errors import ServiceError, for_operators
    from server.storage.database import Database

    async def opened() -> None:
        database = Database.open(settings_with().database_url)
        try:
            await work(database)
        finally:
            await database.close()

    try:
        asyncio.run(opened())
    except ServiceError as error:
        refuse(for_operators(error))
    except BrokenPipeError:
        # Whoever reads the output has had enough; the command line ends quietly.
        raise
    except OSError as error:
        refuse(f"{error.filename or 'the system'}: {error.strerror}")
    except SQLAlchemyError as error:
        refuse(f"the database failed: {error.__cause__ or error}")


def refuse(message: str) -> NoReturn:
    """End the program with a line that says what to do."""
    typer.echo(message, err=True)
    raise typer.Exit(1)
