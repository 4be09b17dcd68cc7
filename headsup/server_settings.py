"""What commands of the server start from: its settings, its policy, its database, or a line that says what is wrong."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import typer

if TYPE_CHECKING:
    from server.life.policy import Policy
    from server.settings import Settings
    from server.storage.database import Database


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


def with_database(work: Callable[[Database], Awaitable[None]], *, makes: bool = False) -> None:
    """Run `work` on the database of the settings; exits with a line when it is refused or the database fails.

    A file of SQLite that is not there is made if `makes`, and refused otherwise: the command was meant for another.
    """
    from sqlalchemy.exc import SQLAlchemyError

    from server.errors import ServiceError, for_operators
    from server.storage.database import Database

    url = settings_with().database_url
    if not makes:
        _must_be_there(url)

    async def opened() -> None:
        database = Database.open(url)
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


def _must_be_there(database_url: str) -> None:
    from sqlalchemy.engine import make_url

    url = make_url(database_url)
    if url.get_backend_name() == "sqlite" and not Path(url.database or "").exists():
        refuse(f"there is no database {url.database}: say by HEADSUP_DATABASE_URL where it is")


def refuse(message: str) -> NoReturn:
    """End the program with a line that says what to do."""
    typer.echo(message, err=True)
    raise typer.Exit(1)
