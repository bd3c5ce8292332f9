"""``coordinator web``: the service in a browser. ``serve`` and ``run`` start it as a process, and restart it."""

import argparse
import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from atoll.cli.exit_codes import DONE
from atoll.client.local_processes import start_in_new_session
from atoll.client.over_http import TOKEN
from atoll.terminal.output import note, say
from atoll_core.errors import UsageError
from atoll_core.wire.security.credentials import Credentials

_AGAIN_S: Final = 1.0
_STOP_LIMIT_S: Final = 3.0

OWNER: Final = "ATOLL_WEB_OWNER"
"""Environment variable with the id of our parent process; this process ends when the parent has ended."""

USAGE: Final = 2
"""The exit code for wrong options; such a process is not restarted."""


def opening(url: str, token: str, is_terminal: bool, is_given: bool) -> str:
    """Return the address of the page as a sentence; only a terminal shows the token, because other users can read
    logs."""
    if is_terminal:
        return f"open {url}?token={token}"
    if is_given:
        return f"open {url}"
    return f"open {url} with the token in {TOKEN}; set this variable, because the token is not printed into logs"


@contextlib.contextmanager
def web_process(
    address: str, listen: tuple[str, int] | None, own: Credentials | None = None, users: str | None = None
) -> Iterator[None]:
    """Run ``coordinator web`` for the coordinator at `address` during the block; without `listen`, do nothing.

    The process uses the `own` certificate of the coordinator for browsers and for the bus; `users` is the file of
    users.
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
    # The token stays the same after a restart, so that open pages stay connected.
    environment = {TOKEN: token_of(os.environ), OWNER: str(os.getpid())}
    stop = threading.Event()
    keeper = threading.Thread(target=_keep, args=(command, environment, stop), name="web", daemon=True)
    keeper.start()
    try:
        yield
    finally:
        stop.set()
        keeper.join(_STOP_LIMIT_S + 1.0)


def _keep(command: list[str], environment: dict[str, str], stop: threading.Event) -> None:
    """Keep a process running until `stop` is set; print its address on stderr."""
    while not stop.is_set():
        process = start_in_new_session(command, environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE)
        assert process.stdout is not None
        with process.stdout as output:
            if line := output.readline().decode("utf-8", "replace").strip():
                url = line.removeprefix("open ")
                note(opening(url, environment[TOKEN], sys.stderr.isatty(), TOKEN in os.environ))
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


_LOOK_S: Final = 1.0


def web(options: argparse.Namespace) -> int:
    """Answer browsers until SIGTERM or Ctrl-C; return 0. The coordinator may start later, or be restarted."""
    from atoll.cli.request import bus_address_of

    try:
        from atoll.web.access import token_of
        from atoll.web.server import Listener, access_of, serve
    except ImportError as error:
        raise UsageError(
            f"the browser page needs {error.name}, which is not installed; pip install 'atoll[web]'"
        ) from error
    at = bus_address_of(options)
    host, port = options.listen
    if (options.cert is None) != (options.key is None):
        raise UsageError("--cert and --key belong together; give both or neither")
    listener = Listener(host, port, options.allow_host, options.cert, options.key)
    token = token_of()
    users = Path(options.users) if options.users is not None else None
    access = access_of(listener, at, token, users, look_without_token=options.look_without_token)
    _end_with(os.environ.get(OWNER))
    is_known = TOKEN in os.environ
    os.environ |= {TOKEN: "", "OPENBLAS_NUM_THREADS": "1", "PYTHONSAFEPATH": "1"}  # for the process that reads files
    serve(listener, access, lambda url: say(opening(url, token, sys.stdout.isatty(), is_known)))
    return DONE


def _end_with(owner: str | None) -> None:
    """End this process when its parent process has ended for any reason."""
    if owner is None or not owner.isdecimal():
        return
    if hasattr(signal, "SIGHUP"):  # SIGHUP to all processes of a service is for its coordinator only
        signal.signal(signal.SIGHUP, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == int(owner):
            time.sleep(_LOOK_S)
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=watch, name="owner", daemon=True).start()
