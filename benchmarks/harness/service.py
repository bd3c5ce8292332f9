"""A coordinator and workers as processes of this machine, for benchmarks that search many times.

Starting them and loading kernels takes seconds, so that is done once, and before any time is taken. Whatever happens,
the processes end with the ``with`` block, or with this process.
"""

import os
import subprocess
import sys
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any, Final

from atoll.config import PRESETS, JobConfig
from atoll.data.table import Table
from atoll.errors import AtollError, UnreachableError
from atoll.wire.messages.views import FINAL_STATES, JobView
from atoll_coordinator.cli.local.workers import worker_command
from atoll_coordinator.cli.signals import raising_interrupts
from atoll_coordinator.cli.terminal.output import count, duration, error_text, note
from atoll_coordinator.client import Client, connected
from benchmarks.harness.systems import trajectories
from benchmarks.kernels.derivatives import table_of

CONNECT_LIMIT_S: Final = 20.0
KERNELS_LIMIT_S: Final = 600.0
"""How long workers may take until they are ready; the first time on a machine they compile the kernels."""

PATIENCE: Final = 12
"""Times that a coordinator is asked for the state of a job until it counts as gone."""
STOP_LIMIT_S: Final = 5.0
_LOOK_S: Final = 0.1
TIED_COORDINATOR: Final = """
import sys
from atoll_coordinator.cli.main import main
from atoll_island_worker.processes.signals import end_with_parent
end_with_parent(int(sys.argv[1]))
sys.exit(main(sys.argv[2:]))
"""
"""The coordinator's program, which ends also when this process is killed, as workers do by themselves."""

_SAY_S: Final = 15.0


class JobEndedError(AtollError):
    """Raised when a job ended without a result; `view` is its last state."""

    def __init__(self, name: str, view: JobView) -> None:
        """Say how the job called `name` ended."""
        super().__init__(f"the job {name} is {view.state}: {view.reason}")
        self.view: Final = view


class Searches:
    """Gives jobs to a coordinator, one after the other."""

    def __init__(
        self, client: Client, address: str, processes: Sequence[subprocess.Popen[str]], log: Path | None = None
    ) -> None:
        """Use a `client` of the coordinator at `address`; `processes`, it and the workers, write their `log`."""
        self.address = address
        self.pids: Final = tuple(process.pid for process in processes)
        self.log: Final = log
        self._client = client
        self._processes = processes

    def solve(
        self,
        name: str,
        table: Table,
        config: JobConfig,
        watch: Callable[[JobView], None] | None = None,
        prefix: str = "bench",
    ) -> dict[str, Any]:
        """Submit a job on `table`, follow it to its end and return what its result.json holds.

        Args:
            name: for people.
            table: what was measured.
            config: of the search.
            watch: called with the state of the job ten times a second; a TimeoutError of its cancels
                the job.
            prefix: what the id of the job begins with.

        Raises:
            AtollError: the job failed, or a process ended.
        """
        job = f"{prefix}-{uuid.uuid4().hex[:12]}"
        digest = self._client.upload(table.to_bytes())
        self._client.submit(job, name, config, digest)
        try:
            view = self._followed(name, job, watch)
        except TimeoutError as error:
            self._client.cancel(job)
            raise AtollError(f"the job {name} was cancelled: {error}") from error
        if view.state != "done":
            raise JobEndedError(name, view)
        return self._client.result(job)

    def warm_up(self) -> None:
        """Search for one epoch, so that the coordinator, too, has loaded what it needs."""
        config = PRESETS["default"]
        budget = config.budget.model_copy(update={"max_epochs": 1})
        self.solve("warm-up", table_of(trajectories("lotka_volterra")), config.model_copy(update={"budget": budget}))

    def wait_for(self, workers: int) -> None:
        """Wait until `workers` are ready; raises AtollError."""
        end = self._client.now() + KERNELS_LIMIT_S
        while sum(worker.state not in ("compiling", "lost") for worker in self._client.workers()) < workers:
            self.check()
            if self._client.now() > end:
                raise UnreachableError(f"{workers} workers were not ready within {KERNELS_LIMIT_S:.0f} s")
            self._client.pause(_LOOK_S)

    def _followed(self, name: str, job: str, watch: Callable[[JobView], None] | None) -> JobView:
        said = self._client.now()
        while True:
            self.check()
            view = self._status(job)
            if watch is not None:
                watch(view)
            if view.state in FINAL_STATES:
                return view
            if self._client.now() - said > _SAY_S:
                said = self._client.now()
                note(progress(name, view))
            self._client.pause(_LOOK_S)

    def _status(self, job: str) -> JobView:
        """Return the state of a job, asked for again while a loaded machine leaves no time to answer."""
        for _ in range(PATIENCE - 1):
            try:
                return self._client.status(job)
            except UnreachableError as error:
                self.check()
                note(str(error))
        return self._client.status(job)

    def check(self) -> None:
        """Raise AtollError when a process has ended."""
        for process in self._processes:
            if process.poll() is not None:
                raise AtollError(f"a process that the benchmark started ended with code {process.returncode}")


def progress(name: str, view: JobView) -> str:
    """Return a line on a job that is under way."""
    states = [
        f"{each.variable} epoch {each.epoch} error {error_text(each.normalized_error)} size {each.complexity}"
        for each in view.variables
    ]
    head = f"  … {name}: {duration(view.elapsed)}, {count(view.point_evaluations)} point evaluations"
    return "; ".join([head, *states])


@contextmanager
def searching(
    workers: int, environment: dict[str, str] | None = None, program: str = TIED_COORDINATOR
) -> Iterator[Searches]:
    """Start a coordinator and `workers` in `environment` (this process's if None); end them afterwards."""
    with ExitStack() as stack:
        its = stack.enter_context(coordinating(environment, program))
        commands = [worker_command(its.address, f"w{index}") for index in range(workers)]
        ours = [its.process, *(stack.enter_context(its.started(each)) for each in commands)]
        client = stack.enter_context(connected(its.address, CONNECT_LIMIT_S))
        searches = Searches(client, its.address, ours, its.folder / "log")
        searches.wait_for(workers)
        searches.warm_up()
        note(f"{workers} workers ready at {its.address}")
        yield searches


@dataclass(frozen=True)
class Coordinating:
    """A coordinator as a process of this machine; `folder` is removed at its end."""

    address: str
    process: subprocess.Popen[str]
    folder: Path
    log: IO[str]
    environment: dict[str, str] | None

    def started(self, command: Sequence[str]) -> AbstractContextManager[subprocess.Popen[str]]:
        """Start another process, which ends with the block; what it says on stderr goes to the log."""
        return started(command, self.log, self.environment)


@contextmanager
def coordinating(environment: dict[str, str] | None = None, program: str = TIED_COORDINATOR) -> Iterator[Coordinating]:
    """Start a coordinator on a free port, in `environment` (this process's if None); end it afterwards.

    `program` is its Python text, which is given this process's id and the words of a command line.
    """
    with ExitStack() as stack:
        stack.enter_context(raising_interrupts())
        folder = Path(stack.enter_context(TemporaryDirectory(prefix="atoll-benchmark-")))
        log = stack.enter_context((folder / "log").open("w", encoding="utf-8"))
        coordinator = stack.enter_context(started(_serve_command(program, folder), log, environment))
        yield Coordinating(address_in(coordinator, folder / "log"), coordinator, folder, log, environment)


def _serve_command(program: str, folder: Path) -> Sequence[str]:
    options = ["--listen", "tcp/127.0.0.1:0", "--state", str(folder / "state")]
    return [sys.executable, "-c", program, str(os.getpid()), "serve", *options]


def address_in(coordinator: subprocess.Popen[str], log: Path) -> str:
    """Return the address in the line by which a coordinator tells how to start a worker; raises AtollError."""
    assert coordinator.stdout is not None
    for line in coordinator.stdout:
        if "--connect" in line:
            return line.split("--connect")[1].strip()
    raise AtollError(f"the coordinator ended before it listened: {log.read_text('utf-8').strip()[-300:]}")


@contextmanager
def started(
    command: Sequence[str], log: IO[str], environment: dict[str, str] | None = None
) -> Iterator[subprocess.Popen[str]]:
    """Start a process, what it says on stderr going to `log`; end it with the block."""
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=log,
        text=True,
        env=environment,
        start_new_session=True,  # a Ctrl-C on the terminal is this program's alone to handle
    )
    try:
        yield process
    finally:
        _end(process)


def _end(process: subprocess.Popen[str]) -> None:
    process.terminate()
    try:
        process.wait(STOP_LIMIT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    if process.stdout is not None:
        process.stdout.close()
