"""`headsup db replay` and `headsup db prune`: the observation log, decided again or forgotten in time."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from headsup.server_settings import policy_in_force, refuse, settings_with, with_database

if TYPE_CHECKING:
    from server.storage.database import Database

_WEEK_DAYS = 7
_DECIDED_OTHERWISE = 2


def replay_log(
    into: Annotated[str, typer.Option(help="URL of a fresh database that takes the result.")],
    checkpoint: Annotated[
        Path | None, typer.Option(help="File of `headsup db prune` that the replay begins with.", exists=True)
    ] = None,
) -> None:
    """Decide the whole observation log of HEADSUP_DATABASE_URL again, into another database.

    The same obstacles come out, with the same ids. Exits with 2 when reports were decided otherwise than the log says:
    the policy, or the rule, has changed since. A replay that fails leaves no file behind.

    Examples:

        headsup db replay --into sqlite+aiosqlite:///replayed.sqlite3

        headsup db replay --into postgresql+asyncpg://headsup@db/replayed --checkpoint 2026-11-22.jsonl.gz
    """
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    from server.log.replay import Replayed, replay
    from server.log.replay_target import replay_target
    from server.storage import schema

    policy, url = policy_in_force(), settings_with(database_url=into).database_url
    results: list[Replayed] = []
    columns = (SpinnerColumn(), TextColumn("{task.completed:.0f} lines replayed"), TimeElapsedColumn())
    with Progress(*columns, transient=True) as progress:
        task = progress.add_task("replay", total=None)

        async def work(source: Database) -> None:
            await schema.check(source)
            async with replay_target(url) as target:
                results.append(await replay(source, target, policy, checkpoint, lambda: progress.advance(task)))

        with_database(work)
    (done,) = results
    typer.echo(f"{done.reports} reports and {done.acts} acts replayed, {done.different} decided otherwise than before")
    raise typer.Exit(_DECIDED_OTHERWISE if done.different else 0)


def prune_log(
    checkpoint: Annotated[Path, typer.Option(help="File for the state that a later replay begins with.")],
    keep_days: Annotated[
        int | None,
        typer.Option(help="Keep reports received within so many days; else HEADSUP_RETENTION_DAYS.", min=_WEEK_DAYS),
    ] = None,
) -> None:
    """Save a checkpoint of HEADSUP_DATABASE_URL, then delete what vehicles sent longer ago.

    Obstacles, their history and the audit log stay. Keep the checkpoint with the backups: without it the log cannot
    be replayed any more. May run beside a serving server.

    Example:

        headsup db prune --checkpoint checkpoints/2026-11-22.jsonl.gz
    """
    from server.log.pruning import prune
    from server.storage import schema

    times = policy_in_force().times
    keep = timedelta(days=settings_with(retention_days=keep_days).retention_days)

    if checkpoint.exists():
        refuse(f"{checkpoint} exists: name a file that does not")

    async def work(database: Database) -> None:
        await schema.check(database)
        done = await prune(database, keep, checkpoint, datetime.now(UTC), times)
        typer.echo(f"{done.checkpointed} rows saved in {checkpoint}, {done.reports} reports deleted")

    with_database(work)
