"""Workers that a fork server started and left to this process, which is their subreaper.

The fork server loads what workers need, forks them and ends. The system then gives the orphans to their nearest living
ancestor that asked for them, which is this process, as its children: so it can wait for each, and each dies alone.
"""

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from typing import IO, Final

from atoll.command_line import TLS_OPTIONS

_PR_SET_CHILD_SUBREAPER: Final = 36
_POLL_S: Final = 0.01
_MOST: Final = 65_536


def become_subreaper() -> bool:
    """Have what descends from this process become its child when its parent ends; return whether the system can."""
    if sys.platform != "linux":
        return False
    return bool(ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0) == 0)


def plain_environment() -> dict[str, str]:
    """Return this process's environment without certificates: on this machine alone nothing is encrypted."""
    certificates = {variable for variable, _ in TLS_OPTIONS.values()}
    return {name: value for name, value in os.environ.items() if name not in certificates}


class AdoptedProcess:
    """A child that another process started, with as much of `subprocess.Popen` as is needed to end it."""

    def __init__(self, pid: int) -> None:
        """`pid`: of a process whose parent has ended."""
        self.pid = pid
        self.returncode: int | None = None

    def poll(self) -> int | None:
        """Return the exit code, negative for a signal; None while it lives."""
        if self.returncode is None:
            try:
                ended, status = os.waitpid(self.pid, os.WNOHANG)
            except ChildProcessError:  # where SIGCHLD is ignored nobody learns how a child ended
                self.returncode = 0
            else:
                self.returncode = os.waitstatus_to_exitcode(status) if ended else None
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end and return the exit code; raises TimeoutExpired."""
        end = time.monotonic() + (timeout if timeout is not None else float("inf"))
        while (code := self.poll()) is None:
            if time.monotonic() > end:
                raise subprocess.TimeoutExpired(f"process {self.pid}", timeout or 0.0)
            time.sleep(_POLL_S)
        return code

    def terminate(self) -> None:
        """Tell it to end."""
        self._send(signal.SIGTERM)

    def kill(self) -> None:
        """End it."""
        self._send(signal.SIGKILL)

    def _send(self, number: int) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)


class ForkServer:
    """The process that forks the workers. Each of these writes ``name pid`` to a pipe and closes its end of it."""

    def __init__(self, command: Sequence[str], log: IO[bytes]) -> None:
        """Start `command`; what it and the workers say goes to `log`."""
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=log,
            env=plain_environment(),
            start_new_session=True,  # a Ctrl-C on the terminal is ours alone to handle
        )
        assert self._process.stdout is not None
        self._pipe = self._process.stdout
        os.set_blocking(self._pipe.fileno(), False)
        self._said = b""
        self._is_closed = False

    def poll(self) -> bool:
        """Read what the workers have written; return whether the process has ended and all of them are our children."""
        while not self._is_closed:
            try:
                part = os.read(self._pipe.fileno(), _MOST)
            except BlockingIOError:
                return False
            self._said += part
            self._is_closed = not part
        return self._process.poll() is not None

    def workers(self) -> dict[str, AdoptedProcess]:
        """Return the workers by name, all of them once `poll` returns True; closes the pipe."""
        self._pipe.close()
        lines = [line.split() for line in self._said.decode().splitlines()]
        return {name: AdoptedProcess(int(pid)) for name, pid in lines}

    def terminate(self) -> None:
        """Tell it to end; workers that it has forked live on."""
        self._process.terminate()

    def kill(self) -> None:
        """End it; workers that it has forked live on."""
        self._process.kill()

    def wait(self, limit_s: float) -> None:
        """Wait until `poll` returns True, within a limit."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(limit_s)
        end = time.monotonic() + limit_s
        while not self.poll() and time.monotonic() < end:
            time.sleep(_POLL_S)
