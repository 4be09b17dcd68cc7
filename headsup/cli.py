"""`headsup`: every command of the project. Heavy imports happen inside a command, so that `--help` is instant."""

from __future__ import annotations

import typer

from headsup.compile_command import compile_loops
from headsup.database_commands import db_app
from headsup.demo.command import demo
from headsup.detect_command import detect_files
from headsup.drive_command import drive, record
from headsup.evaluate.app import evaluate_app
from headsup.key_commands import keys_app
from headsup.policy_command import policy_app
from headsup.server_commands import serve
from headsup.simulate.app import simulate_app

NOWHERE_TO_KEEP = "no locator available"
"""Numba's words where it can write neither beside the program, nor in the user's cache."""

OUR_PACKAGES = ("contract", "detector", "vehicle_client", "server", "simulator", "evaluation", "headsup", "migrations")

app = typer.Typer(
    help="A car that sees a pothole warns every car behind it.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
app.command("compile")(compile_loops)
app.command("demo")(demo)
app.command("detect")(detect_files)
app.command("drive")(drive)
app.command("record")(record)
app.command("serve")(serve)
app.add_typer(simulate_app, name="simulate")
app.add_typer(evaluate_app, name="evaluate")
app.add_typer(keys_app, name="keys")
app.add_typer(db_app, name="db")
app.add_typer(policy_app, name="policy")


def main() -> None:
    """Entry point of the `headsup` script."""
    try:
        app()
    except ModuleNotFoundError as error:
        if error.name is None or error.name.split(".")[0] in OUR_PACKAGES:
            raise
        raise SystemExit(
            f"headsup: {error.name} is not installed; run `make setup`, or pip install '.[all]' in the project's folder"
        ) from None
    except ImportError as error:
        # Ctrl-C while a compiled module is being loaded.
        if not isinstance(error.__cause__, KeyboardInterrupt):
            raise
        raise SystemExit(130) from None
    except RuntimeError as error:
        if NOWHERE_TO_KEEP not in str(error):
            raise
        raise SystemExit(
            "headsup: compiled loops can be kept neither beside the program nor in the home folder; "
            "set NUMBA_CACHE_DIR to a folder that can be written"
        ) from None


if __name__ == "__main__":
    main()
