"""Island workers on a Dask cluster: a plugin starts the program on each Dask worker, including later Dask workers.

When a Dask worker is retired or closed, the plugin first hands its islands over. When a Dask worker is killed, the
program notices the end of its parent and hands its islands over by itself.
"""

import asyncio
import contextlib
import uuid
from collections.abc import Mapping
from typing import Any, Final

from distributed import Client, Worker
from distributed.diagnostics.plugin import WorkerPlugin

from atoll.workers.start import Handle, MachineWorkers, ProgramOptions, WorkerProgram, drain_limit_s, limited
from atoll_core.errors import AtollError, UnreachableError, UsageError

ANSWER_LIMIT_S: Final = 30.0
"""Time limit for an answer of the Dask cluster, in seconds."""


_NO_ANSWER: Final = "the Dask cluster has not answered"
_NOT_ENDED: Final = "the island workers of the Dask cluster have not ended"


class DaskIslandWorkers(WorkerPlugin):  # type: ignore[misc]  # Dask's classes have no types
    """Starts the program on a Dask worker. Only the name of this class, strings and numbers are sent there."""

    def __init__(self, name: str, options: ProgramOptions, processes: int | None) -> None:
        """Keep the program's options; `processes` None: one for each thread of the Dask worker."""
        self.name: Final = name
        self._options = options
        self._processes = processes
        self._program: WorkerProgram | None = None

    def setup(self, worker: Worker) -> None:
        """Start the program; called once on each Dask worker."""
        self._program = WorkerProgram(self._options, self._processes or worker.state.nthreads)

    async def teardown(self, worker: Worker) -> None:
        """Hand the islands over; called when the Dask worker closes regularly, or the plugin is removed."""
        if self._program is not None:
            await asyncio.to_thread(self._program.drain)

    def state(self) -> tuple[int, int | None]:
        """Return the number of processes and the program's exit code."""
        assert self._program is not None
        return self._program.processes, self._program.exit_code()


class DaskHandle(Handle):
    """The island workers of one call of `start`; the plugin's name identifies them."""

    def __init__(self, client: Client, name: str, options: ProgramOptions, *, owns: bool) -> None:
        """`owns`: whether `close` also closes the client."""
        self._client = client
        self._name = name
        self._drain_limit_s = drain_limit_s(options)
        self._owns = owns
        self._is_closed = False

    def machines(self) -> Mapping[str, MachineWorkers]:
        """Return the programs by the addresses of the Dask workers."""
        if self._is_closed:
            return {}
        states = limited(lambda: self._client.run(state_on, self._name, on_error="ignore"), ANSWER_LIMIT_S, _NO_ANSWER)
        return {address: MachineWorkers(*state) for address, state in states.items() if state is not None}

    def close(self) -> None:
        """Remove the plugin, which ends the programs."""
        if self._is_closed:
            return
        self._is_closed = True
        try:
            limit_s = ANSWER_LIMIT_S + self._drain_limit_s
            limited(lambda: self._client.unregister_worker_plugin(self._name), limit_s, _NOT_ENDED)
        finally:
            if self._owns:
                self._client.close(timeout=ANSWER_LIMIT_S)


def start(client: Client | str, options: ProgramOptions, processes: int | None) -> DaskHandle:
    """Start the program on every Dask worker."""
    owns = isinstance(client, str)
    dask = _connected(client) if isinstance(client, str) else client
    if dask.asynchronous:
        raise UsageError("an asynchronous distributed.Client was given; give a client without asynchronous=True")
    name = f"atoll-island-workers-{uuid.uuid4().hex[:12]}"
    handle = DaskHandle(dask, name, options, owns=owns)
    plugin = DaskIslandWorkers(name, options, processes)
    try:
        limited(lambda: dask.register_plugin(plugin, name=name), ANSWER_LIMIT_S, _NO_ANSWER)
    except BaseException as error:
        with contextlib.suppress(Exception):  # there may be no plugin to remove
            handle.close()
        if isinstance(error, Exception) and not isinstance(error, AtollError):
            raise AtollError(
                f"the Dask workers did not start island workers ({error}); they need the same version of Atoll as "
                "this machine"
            ) from error
        raise
    return handle


def state_on(name: str, dask_worker: Any) -> tuple[int, int | None] | None:
    """Return the state of the plugin `name`; runs on a Dask worker, which Dask passes as `dask_worker`."""
    plugin = dask_worker.plugins.get(name)
    return None if plugin is None else plugin.state()


def _connected(address: str) -> Client:
    try:
        return Client(address, timeout=ANSWER_LIMIT_S, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise UnreachableError(
            f"no Dask scheduler answers at {address} ({type(error).__name__}); check the address and that it runs"
        ) from error
