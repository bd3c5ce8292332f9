"""The page that `serve --http` and `run --web` start: `coordinator web` with users and certificates, kept running."""

import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from atoll.cli.verbs import web as module
from atoll.client.over_http import TOKEN
from atoll_core.wire.security.credentials import Credentials

LIMIT_S = 60.0


def test_a_page_that_dies_is_started_again_as_it_was(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Pages that are open go on by the same token, users stay users, and nobody looks without a token."""
    monkeypatch.delenv(TOKEN, raising=False)
    monkeypatch.setattr(module, "_AGAIN_S", 0.0)
    started: list[tuple[list[str], dict[str, str]]] = []
    is_again = threading.Event()

    def start(command: Sequence[str], given: Mapping[str, str], **streams: Any) -> subprocess.Popen[bytes]:
        started.append(([*command], dict(given)))
        if len(started) == 3:
            is_again.set()
        code = "print('open http://127.0.0.1:7480', flush=True)"
        return subprocess.Popen[bytes]([sys.executable, "-c", f"{code}; raise SystemExit(1)"], **streams)

    monkeypatch.setattr(module, "start_in_new_session", start)
    own = Credentials(Path("ca.pem"), Path("cert.pem"), Path("key.pem"), "lab")
    with module.web_process("tls/lab:1", ("127.0.0.1", 7480), own, "users.toml"):
        assert is_again.wait(LIMIT_S)
    assert all(one == started[0] for one in started)
    command, given = started[0]
    assert command[3:8] == ["web", "--connect", "tls/lab:1", "--listen", "127.0.0.1:7480"]
    assert command[8:] == [
        "--tls-ca", "ca.pem", "--tls-cert", "cert.pem", "--tls-key", "key.pem",
        "--cert", "cert.pem", "--key", "key.pem", "--users", "users.toml",
    ]  # fmt: skip
    assert len(given[TOKEN]) >= 16
    said = "".join(capsys.readouterr())
    assert "it is started again" in said
    assert given[TOKEN] not in said + " ".join(command)
