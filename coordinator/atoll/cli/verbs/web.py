"""``coordinator web``: the service in a browser, and its API over HTTP; a client of the coordinator."""

import argparse
import os
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Final

from atoll.cli.exit_codes import DONE
from atoll.cli.request import bus_address_of
from atoll.cli.web_process import OWNER, opening
from atoll.client.over_http import TOKEN
from atoll.terminal.output import say
from atoll_core.errors import UsageError

_LOOK_S: Final = 1.0


def web(options: argparse.Namespace) -> int:
    """Answer browsers until SIGTERM or Ctrl-C; return 0. The coordinator may come later, or go and come back."""
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
        raise UsageError("--cert and --key belong together; give both, or none")
    listener = Listener(host, port, options.allow_host, options.cert, options.key)
    token = token_of()
    users = Path(options.users) if options.users is not None else None
    access = access_of(listener, at, token, users, look_without_token=options.look_without_token)
    _end_with(os.environ.get(OWNER))
    serve(listener, access, lambda url: say(opening(url, token, sys.stdout.isatty(), TOKEN in os.environ)))
    return DONE


def _end_with(owner: str | None) -> None:
    """End this process when the one that has started it is gone, however that ended."""
    if owner is None or not owner.isdecimal():
        return
    if hasattr(signal, "SIGHUP"):  # a hang-up that is sent to all processes of a service is for its coordinator
        signal.signal(signal.SIGHUP, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == int(owner):
            time.sleep(_LOOK_S)
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=watch, name="owner", daemon=True).start()
