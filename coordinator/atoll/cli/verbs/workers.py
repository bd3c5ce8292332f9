"""The verb that lists the workers of a coordinator, or shows the coordinator's own counters."""

import argparse

from pydantic_core import to_jsonable_python

from atoll.cli.exit_codes import DONE
from atoll.cli.request import CONNECT_LIMIT_S, address_of
from atoll.cli.worker_table import coordinator_lines, worker_table
from atoll.client.client import connected
from atoll.terminal.output import as_json, say


def workers(options: argparse.Namespace) -> int:
    """List all workers, or those whose name begins with ``options.job``; or show the coordinator's own counters."""
    address = address_of(options)
    with connected(address, CONNECT_LIMIT_S) as client:
        views = client.workers(options.job or "")
        own = client.coordinator() if options.coordinator else None
    if options.coordinator:
        say(as_json(to_jsonable_python(own)) if options.json else coordinator_lines(own))
    elif options.json:
        say(as_json(to_jsonable_python(views)))
    else:
        say(worker_table(views) if views else f"no worker is here; start one with: island-worker --connect {address}")
    return DONE
