"""Settings, and the deployment files that set them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml
from pydantic import SecretStr, ValidationError

from server.settings import Settings

ROOT = Path(__file__).parents[3]


def test_the_defaults_work_on_a_laptop(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("HEADSUP_DATABASE_URL", raising=False)
    settings = Settings()
    assert (settings.host, settings.port, settings.policy) == ("127.0.0.1", 8000, "cooperation")
    assert not settings.listens_beyond_loopback


@pytest.mark.parametrize(("host", "beyond"), [("::1", False), ("localhost", False), ("0.0.0.0", True), ("a.b", True)])  # noqa: S104
def test_what_listens_beyond_loopback(host: str, beyond: bool) -> None:
    assert Settings(host=host).listens_beyond_loopback is beyond


@pytest.mark.parametrize(
    "wrong",
    [
        {"database_url": "mysql://x/y"},
        {"database_url": "nonsense"},
        {"database_url": "sqlite+aiosqlite://"},
        {"bootstrap_operator_key": SecretStr("short")},
        {"bootstrap_operator_key": SecretStr("")},
        {"port": 70_000},
        {"policy": "strict"},
        {"write_deadline_s": 0},
        {"retention_days": 6},
        {"vehicle_rate_hz": 0},
        {"failed_keys_per_minute": float("nan")},
        {"trusted_proxies": "*"},
        {"trusted_proxies": "10.0.0.1/8"},
        {"cors_origins": "*"},
        {"cors_origins": "map.example"},
        {"cors_origins": "https://map.example/page"},
        {"metrics": "everybody"},
        {"log_format": "xml"},
    ],
)
def test_what_cannot_work_is_refused_on_load(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        Settings(**wrong)  # type: ignore[arg-type]


def test_the_environment_is_read_and_the_key_is_not_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HEADSUP_POLICY", "paper")
    monkeypatch.setenv("HEADSUP_BOOTSTRAP_OPERATOR_KEY", "k" * 40)
    settings = Settings()
    assert settings.policy == "paper"
    assert "kkkk" not in repr(settings)


def compose() -> dict:
    return yaml.safe_load((ROOT / "docker-compose.yml").read_text())


def test_every_variable_of_the_deployment_is_a_setting() -> None:
    known = {f"HEADSUP_{name.upper()}" for name in Settings.model_fields}
    used = {name for service in compose()["services"].values() for name in service.get("environment", {})}
    docker = {word.split("=")[0] for word in (ROOT / "Dockerfile").read_text().split() if word.startswith("HEADSUP_")}
    assert {name for name in used | docker if name.startswith("HEADSUP_")} <= known
    assert "HEADSUP_BOOTSTRAP_OPERATOR_KEY" in used


def test_the_composed_values_are_accepted(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in compose()["services"]["server"]["environment"].items():
        monkeypatch.setenv(name, "k" * 44 if value.startswith("${") else value)
    assert Settings().listens_beyond_loopback


def test_compose_starts_only_with_an_operator_key() -> None:
    value = compose()["services"]["server"]["environment"]["HEADSUP_BOOTSTRAP_OPERATOR_KEY"]
    assert value.startswith("${HEADSUP_BOOTSTRAP_OPERATOR_KEY:?run ")
    assert value.count("}") == 1


def test_no_service_runs_as_root_or_writes_to_its_image() -> None:
    for name, service in compose()["services"].items():
        assert service["user"].split(":")[0] not in ("0", "root"), name
        assert service["read_only"] is True, name
        image = service["image"]
        assert ":" in image, name
        assert not image.endswith(":latest"), name


def documented() -> dict[str, str]:
    """Variables of the table in docs/operations.md, with the default that it gives."""
    text = (ROOT / "docs" / "operations.md").read_text()
    return dict(re.findall(r"^\| `(HEADSUP_\w+)` \| `?(.*?)`? \|", text, re.MULTILINE))


def test_every_setting_is_documented_with_its_default() -> None:
    def written(value: object) -> str:
        if value is None or value == ():
            return "none" if value is None else "empty"
        return f"{value:g}" if isinstance(value, float) else str(value)

    defaults = {f"HEADSUP_{name.upper()}": field.default for name, field in Settings.model_fields.items()}
    assert documented() == {name: written(value) for name, value in defaults.items()}


def test_every_variable_that_the_page_names_is_a_setting() -> None:
    named = set(re.findall(r"HEADSUP_[A-Z_]+[A-Z]", (ROOT / "docs" / "operations.md").read_text()))
    assert named == set(documented())


@pytest.mark.parametrize(
    ("variable", "value", "expected"),
    [
        ("HEADSUP_TRUSTED_PROXIES", "127.0.0.1, 10.0.0.0/8", ("127.0.0.1", "10.0.0.0/8")),
        ("HEADSUP_TRUSTED_PROXIES", "", ()),
        (
            "HEADSUP_CORS_ORIGINS",
            "https://map.example,http://localhost:3000",
            ("https://map.example", "http://localhost:3000"),
        ),
    ],
)
def test_lists_are_written_with_commas(
    monkeypatch: pytest.MonkeyPatch, variable: str, value: str, expected: tuple[str, ...]
) -> None:
    monkeypatch.setenv(variable, value)
    assert getattr(Settings(), variable.removeprefix("HEADSUP_").lower()) == expected


def test_a_batch_that_could_never_be_taken_is_refused_naming_both_settings() -> None:
    with pytest.raises(ValidationError, match="HEADSUP_REPORT_RATE_HZ times HEADSUP_RATE_BURST_S"):
        Settings(report_rate_hz=10, rate_burst_s=5)
