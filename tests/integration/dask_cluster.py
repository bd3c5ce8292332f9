"""A Dask cluster on this machine as its users start it: a scheduler and workers, each a program of its own."""

import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

LIMIT_S = 60.0


@contextmanager
def dask_cluster(workers: int) -> Iterator[Any]:
    """Start a scheduler and workers of one thread each; yields a client once all have come."""
    from distributed import Client

    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory(prefix="atoll-dask-")))
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]

        def start(program: str, *words: str) -> None:
            command = [sys.executable, "-m", f"distributed.cli.dask_{program}", *words, "--host", "127.0.0.1"]
            log = stack.enter_context((folder / f"{program}.log").open("ab"))
            process = subprocess.Popen(
                [*command, "--no-dashboard"], stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True
            )
            stack.callback(process.wait, LIMIT_S)
            stack.callback(process.kill)

        address = f"tcp://127.0.0.1:{port}"
        start("scheduler", "--port", str(port))
        for _ in range(workers):
            start("worker", address, "--no-nanny", "--nthreads", "1", "--local-directory", str(folder))
        client = stack.enter_context(Client(address, timeout=LIMIT_S, set_as_default=False))
        client.wait_for_workers(workers, timeout=LIMIT_S)
        yield client
