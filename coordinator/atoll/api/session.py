"""The services that this interpreter has started here, one for each number of workers; kept until it ends."""

import atexit
import contextlib
import json
import os
import selectors
import subprocess
import sys
import threading
import time
from numbers import Integral
from typing import Final

from atoll.client.local_workers import start_apart
from atoll.client.options import MOST_WORKERS
from atoll_core.errors import AtollError, UnreachableError, UsageError
from atoll_core.machine import usable_cores

_START_LIMIT_S: Final = 60.0
_END_LIMIT_S: Final = 15.0
_LOCK: Final = threading.Lock()


class LocalService:
    """The process of `atoll.api.host`, with its workers."""

    def __init__(self, workers: int) -> None:
        """Start it; raises AtollError with its reason when it does not listen in time."""
        self.workers = workers
        self.owner = os.getpid()
        command = [sys.executable, "-P", "-m", "atoll.api.host", str(workers), str(self.owner)]
        self._process = start_apart(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        try:
            self.endpoint = self._heard()
        except BaseException:
            self.close()
            raise

    @property
    def is_alive(self) -> bool:
        """Whether it runs, and is ours: a fork has inherited that of its parent."""
        return self.owner == os.getpid() and self._process.poll() is None

    @property
    def reason(self) -> str:
        """Why it has ended by itself; "" where it has not said, as when it was killed."""
        pipe = self._process.stdout
        if pipe is None or pipe.closed:
            return ""
        os.set_blocking(pipe.fileno(), False)  # processes that it has started may still hold the other end
        lines = (pipe.read() or b"").splitlines()
        return str(json.loads(lines[-1]).get("error", "")) if lines else ""

    def close(self) -> None:
        """End it and wait, within a limit, until it is gone with all that it has started."""
        if self.owner != os.getpid():
            return
        for pipe in (self._process.stdin, self._process.stdout):
            with contextlib.suppress(OSError):
                if pipe is not None:
                    pipe.close()
        try:
            self._process.wait(_END_LIMIT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _heard(self) -> str:
        """Return where it listens."""
        pipe = self._process.stdout
        assert pipe is not None
        line, end = b"", time.monotonic() + _START_LIMIT_S
        with selectors.DefaultSelector() as selector:
            selector.register(pipe, selectors.EVENT_READ)
            while not line.endswith(b"\n"):
                if not selector.select(max(0.0, end - time.monotonic())):
                    self._process.kill()
                    raise UnreachableError(f"the local service did not start within {_START_LIMIT_S:g} s")
                part = os.read(pipe.fileno(), 65536)
                if not part:
                    break
                line += part
        said = json.loads(line) if line.strip() else {"error": "the local service ended as it began; see stderr"}
        if "endpoint" not in said:
            raise AtollError(said["error"])
        return str(said["endpoint"])


_services: Final[dict[int, LocalService]] = {}
"""By number of workers: another call may still use that of another number."""


def local_address(workers: int | None = None) -> str:
    """Return the address of the local service, started if there is none, or none with so many workers.

    `workers`: None: as many as there are, or else one for each core that may be used.
    """
    if workers is not None and not (isinstance(workers, Integral) and 1 <= workers <= MOST_WORKERS):
        raise UsageError(f"workers must be a whole number from 1 to {MOST_WORKERS}, but {workers!r} was given")
    with _LOCK:
        for number, service in [*_services.items()]:
            if not service.is_alive:
                del _services[number]
                service.close()
        number = workers or next(iter(_services), None) or usable_cores(os.environ)[0]
        if number not in _services:
            _services[number] = LocalService(number)
        return _services[number].endpoint


def check_service(address: str) -> None:
    """Raise AtollError when `address` is that of a local service that has ended."""
    ended = [service for service in [*_services.values()] if service.endpoint == address and not service.is_alive]
    if ended:
        why = ended[0].reason or "it was killed"
        raise AtollError(f"the local service has ended: {why}; the next call starts another")


def close() -> None:
    """End the local services, if there are any; the next call starts another."""
    with _LOCK:
        while _services:
            _services.popitem()[1].close()


def _forget_lock() -> None:
    """In a fork, another thread of the parent may have held it."""
    global _LOCK
    _LOCK = threading.Lock()  # type: ignore[misc]
    _services.clear()


atexit.register(close)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_lock)
