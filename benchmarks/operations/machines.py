"""A coordinator, workers and perhaps a router as if each were on a machine of its own: to be killed, stopped, cut off.

A worker in a network namespace has a network of its own, joined to this machine's by a pair of virtual interfaces,
which can be taken down: packets are then lost in silence, as on a cut line. That needs root and iproute2 (Linux).
"""

import os
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from atoll.errors import AtollError, UsageError
from atoll_coordinator.cli.local.workers import worker_command
from atoll_coordinator.cli.signals import raising_interrupts
from atoll_coordinator.client import Client, connected
from benchmarks.harness.service import CONNECT_LIMIT_S, Searches

COORDINATOR: Final = "coordinator"
ROUTER: Final = "router"
STOPPED_S: Final = 10.0

_TIED: Final = """
import sys
from atoll_coordinator.cli.main import main
from atoll_island_worker.processes.signals import end_with_parent
end_with_parent(int(sys.argv[1]))
sys.exit(main(sys.argv[2:]))
"""
"""A program of the coordinator's package that ends also when this process is killed, as workers do by themselves."""


class Machines:
    """Programs by name: `coordinator`, perhaps `router`, and workers `w0`, `w1` and so on."""

    def __init__(
        self,
        folder: Path,
        workers: int,
        has_own_router: bool = False,
        has_networks: bool = False,
        guests: Sequence[str] = (),
    ) -> None:
        """`folder` takes state and logs. With `has_networks` each worker gets a network that can be cut.

        `guests` are further workers, which are not started with the others.
        """
        self.workers: Final = tuple(f"w{number}" for number in range(workers))
        self.guests: Final = tuple(guests)
        self.has_own_router: Final = has_own_router
        self._folder = folder
        self._networks = {name: _Network(number) for number, name in enumerate(self.workers)} if has_networks else {}
        self._processes: dict[str, subprocess.Popen[str]] = {}
        self._port = _free_port()
        self.address: Final = f"tcp/127.0.0.1:{self._port}"

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
        with self._log(name).open("a", encoding="utf-8") as log:
            process = subprocess.Popen(
                self._command(name),
                stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=log, text=True, start_new_session=True,
            )  # fmt: skip
        self._processes[name] = process
        if name in (COORDINATOR, ROUTER):
            self._wait_until_it_listens(name, process)

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

    def last_words(self, name: str) -> str:
        """Return the end of a program's log."""
        return self._log(name).read_text("utf-8")[-2000:]

    def open(self) -> None:
        """Start everything."""
        for network in self._networks.values():
            network.make()
        for name in self.names:
            self.start(name)

    def close(self) -> None:
        """End everything. Repeatable."""
        for name in reversed((*self.names, *self.guests)):
            if self.is_running(name):
                self.resume(name)
                self.end(name)
            if name in self._processes:
                self._bury(name)
        for network in self._networks.values():
            network.remove()

    def _log(self, name: str) -> Path:
        return self._folder / f"{name}.log"

    def _command(self, name: str) -> Sequence[str]:
        if name in self._networks:
            network = self._networks[name]
            return [*network.prefix(), *worker_command(f"tcp/{network.outside}:{self._port}", name)]
        if name in (*self.workers, *self.guests):
            return worker_command(self.address, name)
        listen = f"tcp/{'0.0.0.0' if self._networks else '127.0.0.1'}:{self._port}"
        tied = [sys.executable, "-c", _TIED, str(os.getpid())]
        if name == ROUTER:
            return [*tied, "router", "--listen", listen]
        place = ["--router", self.address] if self.has_own_router else ["--listen", listen]
        return [*tied, "serve", *place, "--state", str(self._folder / "state")]

    def _wait_until_it_listens(self, name: str, process: subprocess.Popen[str]) -> None:
        """Read until the line that says how to go on; nothing that these programs print fills a pipe."""
        assert process.stdout is not None
        for line in process.stdout:
            if "--connect" in line or "joined" in line:
                return
        raise AtollError(f"the {name} ended before it was ready: {self.last_words(name).strip()[-300:]}")

    def _signal(self, name: str, number: int) -> None:
        with suppress(ProcessLookupError):
            os.kill(self._processes[name].pid, number)

    def _bury(self, name: str) -> None:
        process = self._processes[name]
        try:
            process.wait(STOPPED_S)
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
        self._space = f"atoll-{mark}-{number}"
        self._line = f"at{mark}v{number}"

    def make(self) -> None:
        """Make it; raises UsageError where that is not allowed."""
        self.remove()
        _ip("netns", "add", self._space)
        _ip("link", "add", self._line, "type", "veth", "peer", "name", "eth0", "netns", self._space)
        _ip("addr", "add", f"{self.outside}/24", "dev", self._line)
        _ip("link", "set", self._line, "up")
        _ip("-n", self._space, "addr", "add", f"{self._inside}/24", "dev", "eth0")
        _ip("-n", self._space, "link", "set", "eth0", "up")
        _ip("-n", self._space, "link", "set", "lo", "up")

    def remove(self) -> None:
        """Remove it, if it is there."""
        for words in (("link", "del", self._line), ("netns", "del", self._space)):
            with suppress(UsageError):
                _ip(*words)

    def set_up(self, up: bool) -> None:
        """Mend or cut the line."""
        _ip("link", "set", self._line, "up" if up else "down")

    def prefix(self) -> Sequence[str]:
        """Return what a command begins with to run there."""
        return ["ip", "netns", "exec", self._space]


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
    done = subprocess.run(["ip", *words], capture_output=True, text=True, timeout=STOPPED_S, check=False)
    if done.returncode:
        raise UsageError(f"ip {' '.join(words)} failed: {done.stderr.strip()}; cut lines need root and iproute2")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


@contextmanager
def running(
    workers: int,
    has_own_router: bool = False,
    has_networks: bool = False,
    keep: Path | None = None,
    guests: Sequence[str] = (),
) -> Iterator[tuple[Machines, Client]]:
    """Start all programs and wait until the workers are ready; end them afterwards.

    `keep` is a folder for state and logs; `guests` are workers that are not started yet.
    """
    with raising_interrupts(), TemporaryDirectory(prefix="atoll-faults-") as made:
        folder = keep or Path(made)
        folder.mkdir(parents=True, exist_ok=True)
        machines = Machines(folder, workers, has_own_router, has_networks, guests)
        try:
            machines.open()
            with connected(machines.address, CONNECT_LIMIT_S) as client:
                Searches(client, machines.address, ()).wait_for(workers)
                yield machines, client
        finally:
            machines.close()
