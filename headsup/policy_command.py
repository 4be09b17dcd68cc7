"""`headsup policy show`: the numbers of the server's rule that are in force, each with its reason."""

from __future__ import annotations

import typer

from headsup.server_settings import policy_in_force

policy_app = typer.Typer(help="The numbers of the server's rule.", no_args_is_help=True)


@policy_app.callback()
def _group() -> None:
    """The numbers of the server's rule."""


@policy_app.command("show")
def show_policy() -> None:
    """Print the policy in force as a file that HEADSUP_POLICY_FILE takes, each number under its reason.

    Examples:

        headsup policy show

        HEADSUP_POLICY=paper headsup policy show > policy.toml
    """
    from server.policy_file import as_toml

    typer.echo(as_toml(policy_in_force()), nl=False)
