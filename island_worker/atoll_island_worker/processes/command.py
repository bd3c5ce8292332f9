"""The command of a worker's process that is started afresh."""

import os
import sys
from collections.abc import Sequence

from atoll_core.wire.addresses import Destination
from atoll_island_worker.processes.supervisor import Command


def worker_command(
    connect: Destination,
    name: str,
    wait_s: float | None,
    grace_s: float = 0.0,
    lifetime_s: float | None = None,
    further: Sequence[str] = (),
) -> Command:
    """Return the command of one worker process that ends with this one; `further` are options for it."""
    options = ["--connect", str(connect), *tls_options(connect)]
    options += ["--processes", "1", "--name", name, "--grace", f"{grace_s:g}"]
    options += ["--wait", f"{wait_s:g}"] if wait_s is not None else []
    options += ["--lifetime", f"{lifetime_s:g}"] if lifetime_s is not None else []
    return [sys.executable, "-m", "atoll_island_worker", *options, *further, "--parent", str(os.getpid())]


def tls_options(connect: Destination) -> list[str]:
    """Return the options that name the same certificates for a child."""
    files = connect.credentials
    if files is None:
        return []
    return ["--tls-ca", str(files.authority), "--tls-cert", str(files.certificate), "--tls-key", str(files.key)]
