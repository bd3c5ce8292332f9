"""What a search does besides its result: time that workers wait, messages and bytes on the bus. Seen from outside.

Waiting is read from the system's account of threads (Linux, ``/proc/PID/task/TID/schedstat``): a thread runs, is ready
to run but has no core, or sleeps. The computing thread, which is the one that runs most, sleeps when there is nothing
to compute, that is, while migrants are on their way; waiting for a core, on a busy machine, does not count.
"""

import contextlib
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from atoll_core.wire import topics
from atoll_core.wire.bus.interface import Bus, Message
from atoll_core.wire.bus.zenoh_bus import open_client
from atoll_core.wire.messages.views import JobView
from benchmarks.harness.accounts import PROCESSES

_CONNECT_LIMIT_S: Final = 20.0
_QUIET_S: Final = 0.5
"""No message for so long: all have come."""

Busy = Mapping[int, float]
"""Seconds that each thread of a process, by its number, has run or wanted to."""


def busy(pid: int, processes: Path = PROCESSES) -> dict[int, float]:
    """Return the seconds that each thread of a process has run or been ready to; nothing where this is not known."""
    seconds = {}
    for file in processes.glob(f"{pid}/task/*/schedstat"):
        with contextlib.suppress(OSError, ValueError):  # a thread may end meanwhile
            running, queued, _ = file.read_text("ascii").split()
            seconds[int(file.parent.name)] = (int(running) + int(queued)) / 1e9
    return seconds


def idle_share(before: Busy, after: Busy, seconds: float) -> float | None:
    """Return the share of `seconds` in which the busiest thread slept; None when it is not known."""
    spent = [after[thread] - before[thread] for thread in before.keys() & after.keys()]
    if not spent or seconds <= 0.0:
        return None
    return min(1.0, max(0.0, 1.0 - max(spent) / seconds))


@dataclass
class Idleness:
    """Looks at worker processes while a job's archipelagos are all under way: after the first epoch, before any end."""

    pids: tuple[int, ...]
    processes: Path = PROCESSES
    _first: tuple[float, dict[int, dict[int, float]]] | None = None
    _last: tuple[float, dict[int, dict[int, float]]] | None = None

    def look(self, view: JobView) -> None:
        """Take in the state of the job; called again and again."""
        if not view.variables or any(its.epoch < 1 or its.finished for its in view.variables):
            return
        looked = view.elapsed, {pid: busy(pid, self.processes) for pid in self.pids}
        self._first = self._first or looked
        self._last = looked

    def share(self) -> float | None:
        """Return the mean share of time in which the workers' computing threads slept; None when it is not known."""
        if self._first is None or self._last is None:
            return None
        (begun, before), (ended, after) = self._first, self._last
        shares = [idle_share(before[pid], after[pid], ended - begun) for pid in self.pids]
        known = [share for share in shares if share is not None]
        return sum(known) / len(known) if known and len(known) == len(shares) else None


@dataclass
class Traffic:
    """Messages and bytes of payload by kind: migrants, report, status (heartbeat), control."""

    messages: Counter[str] = field(default_factory=Counter)
    size_bytes: Counter[str] = field(default_factory=Counter)

    def add(self, message: Message) -> None:
        """Count one message."""
        kind = kind_of(message.key)
        self.messages[kind] += 1
        self.size_bytes[kind] += len(message.payload)


def kind_of(key: str) -> str:
    """Return what is sent on `key`; raises RemoteProtocolError for a key that is none of ours."""
    match topics.parse(key):
        case topics.MailKey():
            return "migrants"
        case topics.WorkerKey(part=part):
            return part
        case topics.ControlKey():
            return "control"
        case _:
            return "other"


@dataclass(frozen=True)
class Load:
    """What goes over the bus: by kind, messages and bytes for each epoch; of heartbeats, for each second."""

    workers: int
    migrant_messages: float
    migrant_bytes: float
    report_messages: float
    report_bytes: float
    heartbeats: float
    heartbeat_bytes: float


def load_of(workers: int, traffic: Traffic, epochs: int, archipelagos: int, seconds: float) -> Load:
    """Return the load of searches of `epochs` epochs that took `seconds`; after the last one nobody emigrates."""
    messages, size = traffic.messages, traffic.size_bytes
    reshuffles = archipelagos * max(1, epochs - 1)
    return Load(
        workers,
        messages["migrants"] / reshuffles,
        size["migrants"] / reshuffles,
        messages["report"] / (archipelagos * epochs),
        size["report"] / (archipelagos * epochs),
        messages["status"] / seconds,
        size["status"] / seconds,
    )


@contextlib.contextmanager
def counting(address: str, cluster: str) -> Iterator[Traffic]:
    """Count everything that is put on the bus of the coordinator at `address`; complete at the end of the block.

    Questions and their answers, such as the transfer of the dataset, are not among it.
    """
    traffic = Traffic()
    with open_client(address, wait_s=_CONNECT_LIMIT_S) as bus:
        bus.subscribe(f"{topics.ROOT}/{cluster}/**")
        _drain(bus, traffic)
        traffic.messages.clear()
        traffic.size_bytes.clear()
        yield traffic
        _drain(bus, traffic)


def _drain(bus: Bus, traffic: Traffic) -> None:
    """Count what has come, until nothing has for a while; heartbeats alone do not keep it up for ever."""
    end = bus.now() + 10 * _QUIET_S
    while bus.now() < end and (event := bus.receive(_QUIET_S)) is not None:
        if isinstance(event, Message):
            traffic.add(event)
