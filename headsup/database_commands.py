"""`headsup db`: the schema of the server's database, a copy of it, and its log (`headsup.log_commands`)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from headsup.log_commands import prune_log, replay_log
from headsup.server_settings import refuse, settings_with, with_database

if TYPE_CHECKING:
    from server.storage.database import Database

db_app = typer.Typer(help="The server's database.", no_args_is_help=True)
db_app.command("replay")(replay_log)
db_app.command("prune")(prune_log)
_OUT_OF_DATE = 2


@db_app.command("upgrade")
def upgrade_database() -> None:
    """Bring the database's schema to this version; harmless when it already is.

    Example:

        HEADSUP_DATABASE_URL=postgresql+asyncpg://headsup@db/headsup headsup db upgrade
    """
    from server.storage import schema

    async def upgrade(database: Database) -> None:
        typer.echo(f"the database is at {await schema.upgrade(database)}", err=True)

    with_database(upgrade, makes=True)


@db_app.command("downgrade")
def downgrade_database(
    revision: Annotated[str, typer.Argument(help="Revision to go back to, from `headsup db status`.")],
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask.")] = False,
) -> None:
    """Take the schema back to an earlier version's.

    Stop the servers and make a backup first: what only the later schema can hold is deleted.

    Example:

        headsup db downgrade 2026_11_22_first_tables
    """
    from server.storage import schema

    if not yes:
        typer.confirm(f"Go back to {revision}, and delete what only a later schema can hold?", abort=True)

    async def downgrade(database: Database) -> None:
        typer.echo(f"the database is at {await schema.downgrade(database, revision)}", err=True)

    with_database(downgrade)


@db_app.command("status")
def show_status() -> None:
    """Say which revision the schema is at, and list all there are. Exits with 2 when it is not this version's.

    Example:

        headsup db status
    """
    from server.storage import schema

    found: list[str | None] = []

    async def look(database: Database) -> None:
        found.append(await schema.current_revision(database))

    with_database(look)
    (current,) = found
    for revision, about in schema.revisions():
        typer.echo(f"{'*' if revision == current else ' '} {revision}  {about}")
    if current == schema.head_revision():
        return
    typer.echo(f"the database is at {current or 'no revision'}: {schema.remedy(current)}", err=True)
    raise typer.Exit(_OUT_OF_DATE)


@db_app.command("backup")
def backup_database(target: Annotated[Path, typer.Argument(help="New file for the copy.")]) -> None:
    """Copy the SQLite database of HEADSUP_DATABASE_URL, also while a server uses it.

    To restore, stop the server and put the copy in the database's place, without the -wal and -shm files beside it.

    Example:

        headsup db backup backups/headsup-2026-11-22.sqlite3
    """
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    from server.errors import ServiceError
    from server.storage.backup import backup

    url = settings_with().database_url
    columns = (SpinnerColumn(), TextColumn("copying"), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        progress.add_task("copy", total=None)
        try:
            size_bytes = backup(url, target)
        except ServiceError as error:
            refuse(str(error))
        except OSError as error:
            refuse(f"{error.filename or target}: {error.strerror}")
    typer.echo(f"{target}: {size_bytes / 1e6:.1f} MB")
