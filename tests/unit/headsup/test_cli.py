"""What the `headsup` script makes of errors that no command has foreseen."""

from __future__ import annotations

import pytest

from headsup import cli


def test_ctrl_c_while_a_compiled_module_is_loaded_is_no_missing_module(monkeypatch: pytest.MonkeyPatch) -> None:
    def load(cause: BaseException | None) -> None:
        raise ImportError("initialization failed") from cause

    monkeypatch.setattr(cli, "app", lambda: load(KeyboardInterrupt()))
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 130
    monkeypatch.setattr(cli, "app", lambda: load(None))
    with pytest.raises(ImportError):
        cli.main()
