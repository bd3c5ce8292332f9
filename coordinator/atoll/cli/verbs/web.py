"""``coordinator web``: the service in a browser, and its API over HTTP; a client of the coordinator."""

import argparse
from pathlib import Path

from atoll.cli.exit_codes import DONE
from atoll.cli.request import address_of
from atoll.terminal.output import say
from atoll_core.errors import UsageError


def web(options: argparse.Namespace) -> int:
    """Answer browsers until SIGTERM or Ctrl-C; return 0. The coordinator may come later, or go and come back."""
    try:
        from atoll.web.server import Listener, access_of, serve, token_of
    except ImportError as error:
        raise UsageError(
            f"the browser page needs {error.name}, which is not installed; pip install 'atoll[web]'"
        ) from error
    at = address_of(options)
    host, port = options.listen
    listener = Listener(host, port, options.allow_host, at.credentials)
    token = token_of()
    access = access_of(listener, at, token, Path(options.users) if options.users is not None else None)
    serve(listener, access, token, lambda url: say(f"open {url}"))
    return DONE
