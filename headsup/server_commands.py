"""`headsup serve`. The server is loaded inside it, so that `--help` is instant."""

from __future__ import annotations

from typing import Annotated

import typer

from headsup.server_settings import refuse, serving_settings


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
