"""``coordinator web`` beside ``serve`` and ``run``: a process of its own, which is started again when it dies."""

import contextlib
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from typing import Final

from atoll.client.local_workers import start_apart
from atoll.client.over_http import TOKEN
from atoll.terminal.output import note
from atoll_core.wire.security.credentials import Credentials

_AGAIN_S: Final = 1.0
_STOP_LIMIT_S: Final = 3.0

OWNER: Final = "ATOLL_WEB_OWNER"
"""The variable that names the process with which one that it has started ends."""

USAGE: Final = 2
"""The exit code of a process that cannot be started as it is asked to be: it is not tried again."""


def opening(url: str, token: str, is_terminal: bool, is_given: bool) -> str:
    """Return what says where the page is, on a terminal alone with its token: logs are kept, and read by others."""
    if is_terminal:
        return f"open {url}?token={token}"
    return f"open {url}" if is_given else f"open {url} with the token that {TOKEN} gives; set it, none is shown here"


@contextlib.contextmanager
def web_process(
    address: str, listen: tuple[str, int] | None, own: Credentials | None = None, users: str | None = None
) -> Iterator[None]:
    """Show the coordinator at an address to browsers while the block lasts; nothing unless `listen` is given.

    It shows the coordinator's `own` certificate to browsers and to the bus, if there is one; `users` is a file.
    """
    if listen is None:
        yield
        return
    from atoll.web.access import token_of

    host, port = listen
    command = [sys.executable, "-m", "atoll", "web", "--connect", address, "--listen", f"{host}:{port}"]
    if own is not None:
        command += ["--tls-ca", str(own.authority), "--tls-cert", str(own.certificate), "--tls-key", str(own.key)]
        command += ["--cert", str(own.certificate), "--key", str(own.key)]
    if users is not None:
        command += ["--users", users]
    given = {TOKEN: token_of(os.environ), OWNER: str(os.getpid())}  # the same token after a death: pages go on
    stop = threading.Event()
    keeper = threading.Thread(target=_keep, args=(command, given, stop), name="web", daemon=True)
    keeper.start()
    try:
        yield
    finally:
        stop.set()
        keeper.join(_STOP_LIMIT_S + 1.0)


def _keep(command: list[str], given: dict[str, str], stop: threading.Event) -> None:
    """Keep a process running until `stop`; say on stderr where it listens, between what else is shown there."""
    while not stop.is_set():
        process = start_apart(command, given, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE)
        assert process.stdout is not None
        with process.stdout as said:
            if line := said.readline().decode("utf-8", "replace").strip():
                url = line.removeprefix("open ")
                note(opening(url, given[TOKEN], sys.stderr.isatty(), TOKEN in os.environ))
        while process.poll() is None and not stop.wait(0.2):
            pass
        if process.returncode is None:
            process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_STOP_LIMIT_S)
            process.kill()
            return
        if process.returncode == USAGE:
            return
        note(f"coordinator: the web process ended ({process.returncode}); it is started again in {_AGAIN_S:.0f} s")
        stop.wait(_AGAIN_S)
