"""The known workers, their states and leases. Pure; the time is an argument.

A worker is present while its connection lives, and has a lease that each heartbeat renews. It is *absent* when its
connection ends, *hung* when it sends heartbeats and computes without progress, and *lost* when its absence or silence
is too long. A lost or hung worker may return as the same process; then its islands have usually been placed elsewhere.

*Doubts.* Silence has two causes that look the same here: a worker that hangs, and messages that this coordinator has
not processed. So all leases are renewed after a gap in the checks (`GAP_S`).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final, Literal

from atoll_core import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from atoll_core.wire.messages.handshake import Hello
from atoll_core.wire.messages.views import Counters, WorkerService, WorkerState, WorkerView
from atoll_core.wire.messages.workers import WorkerStatus

LEASE_S: Final = 15.0
"""Seconds of silence after which a connected worker is lost: its process hangs."""

ABSENCE_S: Final = 0.5
"""A worker is lost this number of seconds after the end of its connection; the connection may return earlier. A worker
that is wrongly treated as lost costs the work since the last checkpoint; a longer wait delays the islands of dead
workers."""

STANDING_S: Final = 60.0
"""Seconds of computing without progress after which a worker is hung; loading and compiling do not count."""

GAP_S: Final = 3.0
"""Seconds without a check after which all leases are renewed: the coordinator itself did not process messages."""

FORGET_S: Final = 3600.0
"""Seconds for which lost workers are listed."""

NO_WORKER: Final = (
    "waits for a worker: none has joined since the coordinator was started, or all are lost, leaving or cordoned"
)
"""Sentence for jobs without any worker. Workers are not stored: after a restart they join again within seconds."""

MemberState = Literal["here", "absent", "hung", "lost"]
MemberStep = Literal["heard", "gone", "back", "expired", "stands", "moves"]

MEMBER_TRANSITIONS: Final[Mapping[MemberState, Mapping[MemberStep, MemberState]]] = {
    "here": {"heard": "here", "gone": "absent", "back": "here", "expired": "lost", "stands": "hung", "moves": "here"},
    "absent": {
        "heard": "absent", "gone": "absent", "back": "here", "expired": "lost", "stands": "absent", "moves": "absent",
    },
    "hung": {"heard": "hung", "gone": "absent", "back": "hung", "expired": "lost", "stands": "hung", "moves": "here"},
    "lost": {"heard": "here", "gone": "lost", "back": "lost", "expired": "lost", "stands": "lost", "moves": "here"},
}  # fmt: skip
"""State of a worker -> event -> next state. `heard`: a heartbeat; `gone`, `back`: its connection; `expired`: the end of
its lease; `stands`: it has computed for too long without progress; `moves`: it makes progress."""


@dataclass(slots=True)
class RegisteredWorker:
    """One worker process."""

    hello: Hello
    state: MemberState
    heard_at: float
    gone_at: float | None = None
    status: WorkerStatus | None = None
    progressed_at: float = 0.0
    lost_by: str = ""
    has_our_kernels: bool = False
    joined_at: float = 0.0

    def step(self, step: MemberStep) -> None:
        """Go to the next state by the table."""
        self.state = MEMBER_TRANSITIONS[self.state][step]

    @property
    def is_ready(self) -> bool:
        """Whether islands can be placed on this worker now."""
        if self.state != "here" or self.status is None or not self.has_our_kernels:
            return False
        return self.status.state not in ("compiling", "leaving")

    @property
    def is_leaving(self) -> bool:
        """Whether the worker has announced its end."""
        return self.status is not None and self.status.state == "leaving"


class Membership:
    """All workers by name."""

    def __init__(self, fingerprint: str = "") -> None:
        """`fingerprint` identifies this installation's kernels, which all workers must have; "": any kernels."""
        self._fingerprint = fingerprint
        self._members: dict[str, RegisteredWorker] = {}
        self._checked_at: float | None = None
        self._cordons: dict[str, bool] = {}

    def set_cordons(self, cordons: Mapping[str, bool]) -> None:
        """Set the cordoned workers, which get no more islands, and whether each is drained of its islands."""
        self._cordons = dict(cordons)

    def service(self, worker: str) -> WorkerService:
        """Return whether admins let a worker have islands."""
        if worker not in self._cordons:
            return "open"
        return "draining" if self._cordons[worker] else "cordoned"

    @property
    def checked_at(self) -> float:
        """Time of the last check of leases, in seconds of the bus."""
        return self._checked_at or 0.0

    def __len__(self) -> int:
        return len(self._members)

    def __bool__(self) -> bool:
        return True

    def member(self, worker: str) -> RegisteredWorker | None:
        """Return a worker by name; None: it is unknown."""
        return self._members.get(worker)

    def register(self, hello: Hello, now: float) -> str | None:
        """Add a worker, or return a sentence on why it is refused."""
        refusal = version_refusal(hello) or self._name_refusal(hello) or self._fingerprint_refusal(hello)
        if refusal is not None:
            return refusal
        if self.is_new(hello):
            self._members[hello.name] = RegisteredWorker(hello, "here", now, progressed_at=now, joined_at=now)
        else:
            known = self._members[hello.name]
            known.hello, known.heard_at = hello, now
        if hello.fingerprint == self._fingerprint or not self._fingerprint:
            self._members[
                hello.name
            ].has_our_kernels = True  # an earlier greeting that arrives late has no fingerprint and changes nothing
        return None

    def record_heartbeat(self, worker: str, status: WorkerStatus, now: float) -> bool:
        """Record a heartbeat; return False when this process is not known."""
        member = self._members.get(worker)
        if member is None or member.hello.instance != status.instance:
            return False
        before, member.status, member.heard_at = member.status, status, now
        has_progressed = before is None or status.progress != before.progress
        if has_progressed or member.state == "lost" or not _is_computing(member):
            member.progressed_at = now
        member.step("moves" if has_progressed and member.state == "hung" else "heard")
        return True

    def record_presence(self, worker: str, present: bool, now: float) -> None:
        """Record that a worker's connection was made or lost."""
        member = self._members.get(worker)
        if member is None:
            return
        if present:
            member.step("back")
        elif member.state in ("here", "hung"):
            member.step("gone")
            member.gone_at = now

    def send_away(self, worker: str) -> RegisteredWorker | None:
        """Remove a worker that may no longer take part, so that it must greet again; None: it is not known."""
        return self._members.pop(worker, None)

    def renew_leases(self, now: float) -> None:
        """Renew all leases, because messages may have been lost at the coordinator."""
        for member in self._members.values():
            member.heard_at = member.progressed_at = now
            if member.gone_at is not None:
                member.gone_at = now

    def expire(self, now: float, factors: Mapping[str, float] | None = None) -> list[RegisteredWorker]:
        """Mark workers whose leases have ended as lost or hung; return the workers that were not hung before.

        `factors`, by worker, lengthen leases; `RegisteredWorker.lost_by` is the reason of a loss.
        """
        if self._checked_at is not None and now - self._checked_at > GAP_S:
            self.renew_leases(now)
        self._checked_at = now
        lost = []
        for name, member in self._members.items():
            end = lease_end(member, now, (factors or {}).get(name, 1.0))
            if end is not None:
                lost += [member] if member.state != "hung" else []
                step, member.lost_by = end
                member.step(step)
        self._members = {
            name: member
            for name, member in self._members.items()
            if member.state != "lost" or now - member.heard_at <= FORGET_S
        }
        return lost

    def ready(self) -> tuple[str, ...]:
        """Return the workers that can compute islands, sorted."""
        return tuple(sorted(name for name in self._members if self.is_ready(name)))

    def attending(self) -> Iterator[tuple[str, RegisteredWorker]]:
        """Yield the workers that are present and not leaving, sorted by name; some may still compile their kernels."""
        for name, member in sorted(self._members.items()):
            if member.state == "here" and member.status is not None and not member.is_leaving:
                yield name, member

    def is_ready(self, worker: str) -> bool:
        """Return whether islands can be placed on this worker."""
        member = self._members.get(worker)
        return member is not None and member.is_ready and worker not in self._cordons

    def arriving(self) -> int:
        """Return the number of present workers that are not ready yet."""
        return sum(
            member.state == "here" and not member.is_ready and not member.is_leaving
            for member in self._members.values()
        )

    def waiting_reason(self) -> str:
        """Return a sentence on why an archipelago without workers waits."""
        arriving = self.arriving()
        if arriving:
            return f"waits for {arriving} worker{'s' if arriving > 1 else ''} to load or compile the kernels"
        if not self.ready():
            return NO_WORKER
        return "waits for the other workers to join"

    def has_dataset(self, worker: str, job: str) -> bool:
        """Return whether a worker has a job's dataset, or is fetching it."""
        member = self._members.get(worker)
        return member is not None and member.status is not None and job in member.status.jobs

    def has_room(self, worker: str, needed: int) -> bool:
        """Return whether a worker's machine has this number of bytes of free memory, or does not report its memory."""
        member = self._members.get(worker)
        available = member.status.available_bytes if member is not None and member.status is not None else None
        return available is None or available >= needed

    def is_lost(self, worker: str) -> bool:
        """Return whether a worker is unknown, lost or hung. Such a worker does not compute its islands."""
        member = self._members.get(worker)
        return member is None or member.state in ("lost", "hung")

    def is_leaving(self, worker: str) -> bool:
        """Return whether this worker has announced its end, or is drained: its islands move to other workers."""
        member = self._members.get(worker)
        return self._cordons.get(worker, False) or (member is not None and member.is_leaving)

    def is_new(self, hello: Hello) -> bool:
        """Return whether the name is new, or has a new process."""
        member = self._members.get(hello.name)
        return member is None or member.hello.instance != hello.instance

    def views(self, now: float) -> tuple[WorkerView, ...]:
        """Return the views of all workers, sorted by name."""
        return tuple(
            _view(name, self._members[name], now).model_copy(update={"service": self.service(name)})
            for name in sorted(self._members)
        )

    def _name_refusal(self, hello: Hello) -> str | None:
        known = self._members.get(hello.name)
        if known is None or known.hello.instance == hello.instance or known.state != "here":
            return None
        return (
            f"a worker named {hello.name!r} is already connected from {known.hello.host} (process {known.hello.pid}); "
            "give this worker another name with --name"
        )

    def _fingerprint_refusal(self, hello: Hello) -> str | None:
        """Return why kernels that differ from the coordinator's are refused: their results might have other bits."""
        if not (self._fingerprint and hello.fingerprint) or hello.fingerprint == self._fingerprint:
            return None
        return (
            f"worker {hello.name!r} computes with kernels {hello.fingerprint}, but the coordinator's installation has "
            f"{self._fingerprint}; install the same version {VERSION} of Atoll on both"
        )


def lease_end(member: RegisteredWorker, now: float, factor: float) -> tuple[MemberStep, str] | None:
    """Return event and reason if the lease of a worker has ended; None: it has not. `factor` lengthens leases."""
    if member.state == "absent":
        is_over = member.is_leaving or now - (member.gone_at or 0.0) >= ABSENCE_S
        return ("expired", "its connection was lost") if is_over else None
    silent, standing = now - member.heard_at, now - member.progressed_at
    if member.state in ("here", "hung") and silent >= LEASE_S * factor:
        return "expired", f"silent for {silent:.0f} s"
    if member.state == "here" and _is_computing(member) and standing >= STANDING_S * factor:
        return "stands", f"it has computed for {standing:.0f} s without progress"
    return None


def _is_computing(member: RegisteredWorker) -> bool:
    return member.status is not None and member.status.state == "computing"


def version_refusal(hello: Hello) -> str | None:
    """Return a sentence if the versions of both sides do not fit; clients need only the same protocol."""
    ours = f"Atoll {VERSION} (protocol {PROTOCOL_VERSION}, engine {ENGINE_REVISION})"
    theirs = f"Atoll {hello.version} (protocol {hello.protocol}, engine {hello.engine})"
    fits = hello.protocol == PROTOCOL_VERSION
    if hello.role == "worker":
        fits = fits and hello.version == VERSION and hello.engine == ENGINE_REVISION
    if fits:
        return None
    return f"this {hello.role} is {theirs}, but the coordinator is {ours}; install the same version on both sides"


def _view(name: str, member: RegisteredWorker, now: float) -> WorkerView:
    status = member.status
    state: WorkerState = status.state if status else "compiling"
    if member.state in ("lost", "hung"):
        state = "lost" if member.state == "lost" else "hung"
    return WorkerView(
        worker=name,
        host=member.hello.host,
        pid=member.hello.pid,
        state=state,
        islands=sum(assignment_status.islands for assignment_status in status.holdings)
        if status and state != "lost"
        else 0,
        doing=_doing(status) if status is not None and state != "lost" else "",
        standing=max(0.0, now - member.progressed_at) if _is_computing(member) else 0.0,
        counters=status.counters if status is not None else Counters(),
        silent=max(0.0, now - member.heard_at),
        version=member.hello.version,
        detail=status.detail if status else "",
        joined=max(0.0, now - member.joined_at),
        cores=member.hello.cores,
    )


def _doing(status: WorkerStatus) -> str:
    """Return a text about the island or task that a worker computes, beginning with its job."""
    words = [f"{one.job}/{one.variable} island {one.island} epoch {one.epoch}" for one in [status.doing] if one]
    words += [f"{held.job}/a task" for held in status.tasks if held.state == "running"]
    words += [f"{held.job}/a task of another worker" for held in status.tasks if held.state == "helping"]
    return words[0] if words else ""
