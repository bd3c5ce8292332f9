"""A coordinator, workers and perhaps a router as programs of this machine, each as if on one of its own; jobs for them.

`searching` starts what most benchmarks need, once and before any time is taken. `Machines` can be killed, stopped and
cut off: a worker in a network namespace (root and iproute2, Linux) is joined to this machine by a pair of virtual
interfaces. Taken down, they lose packets in silence. Programs end with the ``with`` block, or with this process.
"""

import os
import shutil
import signal
import socket
import subprocess
import sys
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from atoll.client.client import Client, connected
from atoll.client.local_processes import worker_command
from atoll.terminal.output import count, duration, note
from atoll_core.config import JobConfig
from atoll_core.data.table import Table
from atoll_core.errors import AtollError, UnreachableError, UsageError
from atoll_core.signals import raising_interrupts
from atoll_core.wire.messages.views import FINAL_STATES, JobView
from benchmarks.harness.jobs import configured
from benchmarks.harness.systems import table_of, trajectories
from benchmarks.harness.tables import Columns

COORDINATOR: Final = "coordinator"
ROUTER: Final = "router"
CONNECT_LIMIT_S: Final = 20.0
KERNELS_LIMIT_S: Final = 600.0
"""How long workers may take until they are ready; the first time on a machine they compile the kernels."""

PATIENCE: Final = 12
"""Times that a coordinator is asked for the state of a job until it counts as gone."""
STOP_LIMIT_S: Final = 10.0
_LOOK_S: Final = 0.1
TIED_COORDINATOR: Final = """
import sys
from atoll.cli.main import main
from atoll_island_worker.processes import end_with_parent
end_with_parent(int(sys.argv[1]))
sys.exit(main(sys.argv[2:]))
"""
"""A program of the coordinator's package, which ends also when this process is killed, as workers do by themselves."""

_SAY_S: Final = 15.0


class JobEndedError(AtollError):
    """Raised when a job ended without a result; `view` is its last state."""

    def __init__(self, name: str, view: JobView) -> None:
        """Say how the job called `name` ended."""
        super().__init__(f"the job {name} is {view.state}: {view.reason}")
        self.view: Final = view


class Searches:
    """Gives jobs to a coordinator, one after the other."""

    def __init__(self, client: Client, machines: "Machines") -> None:
        """Use a `client` of the coordinator of `machines`."""
        self._client = client
        self._machines = machines

    @property
    def address(self) -> str:
        """Where the coordinator listens."""
        return self._machines.address

    def solve(
        self, name: str, table: Table, config: JobConfig, watch: Callable[[JobView], None] | None = None
    ) -> dict[str, Any]:
        """Submit a job on `table`, follow it to its end and return what its result.json holds.

        `name` is for people. `watch` is called with the state of the job ten times a second; its TimeoutError cancels
        the job. Raises AtollError where the job failed, or a process ended.
        """
        job = f"bench-{uuid.uuid4().hex[:12]}"
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
        self.solve("warm-up", table_of(trajectories("lotka_volterra")), configured(budget={"max_epochs": 1}))

    def wait_for(self, workers: int) -> None:
        """Wait until `workers` are ready; raises AtollError."""

        def are_ready() -> bool:
            self.check()
            return sum(worker.state not in ("compiling", "lost") for worker in self._client.workers()) >= workers

        wait_until(self._client, are_ready, f"{workers} workers were not ready", KERNELS_LIMIT_S)

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
        """Raise AtollError when a program has ended."""
        self._machines.check()


def wait_until(
    client: Client, is_so: Callable[[], bool], otherwise: str, limit_s: float, look_s: float = _LOOK_S
) -> None:
    """Look again and again whether something is so; raises UnreachableError with `otherwise` when it takes too long."""
    end = client.now() + limit_s
    while not is_so():
        if client.now() > end:
            raise UnreachableError(f"{otherwise} within {limit_s:.0f} s")
        client.pause(look_s)


VARIABLE: Final = Columns(
    "variable | epoch=epoch {epoch} | error=error {normalized_error:error} | size=size {complexity!s}"
)


def progress(name: str, view: JobView) -> str:
    """Return a line on a job that is under way."""
    states = map(" ".join, map(VARIABLE.row, view.variables))
    head = f"  … {name}: {duration(view.elapsed)}, {count(view.point_evaluations)} point evaluations"
    return "; ".join([head, *states])


@dataclass(eq=False)
class Machines:
    """Programs by name: `coordinator`, perhaps `router`, and workers `w0`, `w1` and so on.

    `folder` takes state and logs. With `has_networks` each worker gets a network that can be cut. `guests` are further
    workers, which are not started with the others. With `programs`, a folder of another revision's, those are started;
    `coordinator` is another text of the coordinator's program, `serve_options` are further words of its command line.
    """

    folder: Path
    number: int
    has_own_router: bool = False
    has_networks: bool = False
    guests: tuple[str, ...] = ()
    programs: Path | None = None
    coordinator: str = TIED_COORDINATOR
    serve_options: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        self.workers = tuple(f"w{number}" for number in range(self.number))
        self._networks = {name: _Network(at) for at, name in enumerate(self.workers)} if self.has_networks else {}
        self._processes: dict[str, subprocess.Popen[str]] = {}
        self._port = _free_port()
        self.address = f"tcp/127.0.0.1:{self._port}"

    @property
    def names(self) -> tuple[str, ...]:
        """All programs, those first that others need."""
        return (*([ROUTER] if self.has_own_router else []), COORDINATOR, *self.workers)

    def pid(self, name: str) -> int:
        """Return the process id of a program."""
        return self._processes[name].pid

    def is_running(self, name: str) -> bool:
        """Tell whether a program runs, or is stopped."""
        process = self._processes.get(name)
        return process is not None and process.poll() is None

    def start(self, name: str) -> None:
        """Start a program that does not run; of those that listen, wait until they do."""
        if self.is_running(name):
            return
        self.start_program(name, self._command(name))
        if name in (COORDINATOR, ROUTER):
            self.wait_until_it_listens(name)

    def start_program(self, name: str, command: Sequence[str]) -> subprocess.Popen[str]:
        """Start any program under a name; its stdout can be read."""
        with self.log(name).open("a", encoding="utf-8") as log:
            process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=log, text=True,
                start_new_session=True,  # a Ctrl-C is this program's alone to handle
            )  # fmt: skip
        self._processes[name] = process
        return process

    def check(self) -> None:
        """Raise AtollError when a program that was started has ended."""
        for process in self._processes.values():
            if process.poll() is not None:
                raise AtollError(f"a process that the benchmark started ended with code {process.returncode}")

    def kill(self, name: str) -> None:
        """Let a program die at once (SIGKILL)."""
        self._signal(name, signal.SIGKILL)
        self._bury(name)

    def end(self, name: str) -> None:
        """Ask a program to end (SIGTERM), and wait for it."""
        self._signal(name, signal.SIGTERM)
        self._bury(name)

    def stop(self, name: str) -> None:
        """Stop a program (SIGSTOP) until `resume`."""
        self._signal(name, signal.SIGSTOP)

    def resume(self, name: str) -> None:
        """Let a program go on."""
        self._signal(name, signal.SIGCONT)

    def cut(self, name: str) -> None:
        """Cut a worker's line until `heal`."""
        self._networks[name].set_up(False)

    def heal(self, name: str) -> None:
        """Mend a worker's line."""
        self._networks[name].set_up(True)

    def wait_until_it_listens(self, name: str) -> None:
        """Read until the line that says how to go on, which fills no pipe; raises AtollError when the program ends."""
        process = self._processes[name]
        assert process.stdout is not None
        for line in process.stdout:
            if "--connect" in line or "joined" in line:
                return
        raise AtollError(f"the {name} ended before it was ready: {self.last_words(name).strip()[-300:]}")

    def last_words(self, name: str) -> str:
        """Return the end of a program's log."""
        return self.log(name).read_text("utf-8")[-2000:]

    def open(self) -> None:
        """Start everything."""
        for network in self._networks.values():
            network.make()
        for name in self.names:
            self.start(name)

    def close(self) -> None:
        """End everything. Repeatable."""
        for name in reversed(self._processes):
            if self.is_running(name):
                self.resume(name)
                self._signal(name, signal.SIGTERM)
            self._bury(name)
        for network in self._networks.values():
            network.remove()

    def log(self, name: str) -> Path:
        """Return the file of what a program says on stderr."""
        return self.folder / f"{name}.log"

    def _command(self, name: str) -> Sequence[str]:
        if name in self._networks:
            network = self._networks[name]
            return ["ip", "netns", "exec", network.space, *worker_command(f"tcp/{network.outside}:{self._port}", name)]
        if name in (*self.workers, *self.guests):
            if self.programs is not None:
                return [str(self.programs / "island-worker"), "--connect", self.address, "--processes", "1"]
            return worker_command(self.address, name)
        listen = f"tcp/{'0.0.0.0' if self._networks else '127.0.0.1'}:{self._port}"
        tied = [sys.executable, "-c", self.coordinator, str(os.getpid())]
        if self.programs is not None:
            tied = [str(self.programs / "coordinator")]
        if name == ROUTER:
            return [*tied, "router", "--listen", listen]
        place = ["--router", self.address] if self.has_own_router else ["--listen", listen]
        return [*tied, "serve", *place, "--state", str(self.folder / "state"), *self.serve_options]

    def _signal(self, name: str, number: int) -> None:
        with suppress(ProcessLookupError):
            os.kill(self._processes[name].pid, number)

    def _bury(self, name: str) -> None:
        process = self._processes[name]
        try:
            process.wait(STOP_LIMIT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if process.stdout is not None:
            process.stdout.close()


class _Network:
    """One worker's network: a namespace, and a line to this machine's."""

    def __init__(self, number: int) -> None:
        mark = f"{os.getpid() % 10**6}"
        self.outside: Final = f"10.{100 + os.getpid() % 100}.{number}.1"
        self._inside = f"10.{100 + os.getpid() % 100}.{number}.2"
        self.space: Final = f"atoll-{mark}-{number}"
        self._line = f"at{mark}v{number}"

    def make(self) -> None:
        """Make it; raises UsageError where that is not allowed."""
        self.remove()
        _ip("netns", "add", self.space)
        _ip("link", "add", self._line, "type", "veth", "peer", "name", "eth0", "netns", self.space)
        _ip("addr", "add", f"{self.outside}/24", "dev", self._line)
        _ip("link", "set", self._line, "up")
        _ip("-n", self.space, "addr", "add", f"{self._inside}/24", "dev", "eth0")
        _ip("-n", self.space, "link", "set", "eth0", "up")
        _ip("-n", self.space, "link", "set", "lo", "up")

    def remove(self) -> None:
        """Remove it, if it is there."""
        for words in (("link", "del", self._line), ("netns", "del", self.space)):
            with suppress(UsageError):
                _ip(*words)

    def set_up(self, up: bool) -> None:
        """Mend or cut the line."""
        _ip("link", "set", self._line, "up" if up else "down")


def can_have_networks() -> bool:
    """Tell whether workers can have networks of their own here."""
    if not sys.platform.startswith("linux") or os.geteuid() != 0 or shutil.which("ip") is None:
        return False
    probe = _Network(255)
    try:
        probe.make()
    except UsageError:
        return False
    finally:
        probe.remove()
    return True


def _ip(*words: str) -> None:
    done = subprocess.run(["ip", *words], capture_output=True, text=True, timeout=STOP_LIMIT_S, check=False)
    if done.returncode:
        raise UsageError(f"ip {' '.join(words)} failed: {done.stderr.strip()}; cut lines need root and iproute2")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


@contextmanager
def running(workers: int, keep: Path | None = None, **settings: Any) -> Iterator[tuple[Machines, Client]]:
    """Start all programs and wait until the workers are ready; end them afterwards.

    `keep` is a folder for state and logs; `settings` are those of `Machines`.
    """
    with raising_interrupts(), TemporaryDirectory(prefix="atoll-benchmark-") as made:
        folder = keep or Path(made)
        folder.mkdir(parents=True, exist_ok=True)
        machines = Machines(folder, workers, **settings)
        try:
            machines.open()
            with connected(machines.address, CONNECT_LIMIT_S) as client:
                Searches(client, machines).wait_for(workers)
                yield machines, client
        finally:
            machines.close()


@contextmanager
def searching(workers: int, **settings: Any) -> Iterator[Searches]:
    """Start a coordinator and `workers`, see `Machines`, and load all that they need; end them afterwards."""
    with running(workers, **settings) as (machines, client):
        searches = Searches(client, machines)
        searches.warm_up()
        note(f"{workers} workers ready at {machines.address}")
        yield searches
