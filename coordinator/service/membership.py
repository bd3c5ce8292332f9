"""The workers that the coordinator knows: who is there, in which state, and who is lost. Pure; time comes in."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

from common import ENGINE_REVISION, PROTOCOL_VERSION, VERSION
from common.wire.messages import Hello, WorkerStatus
from common.wire.views import WorkerState, WorkerView

LEASE_S: Final = 15.0
"""Silence after which a worker is lost although its presence is still shown: a process that hangs."""

ABSENCE_S: Final = 0.5
"""How long a worker's presence may be gone (its connection may come back) before it is lost. To take a worker for lost
that is not costs what lies between two checkpoints; to wait costs the wait."""

GAP_S: Final = 3.0
"""If the coordinator itself has not looked for this long, silence is its own fault: everybody gets a fresh lease."""

FORGET_S: Final = 3600.0
"""How long lost workers stay in the list."""

MemberState = Literal["here", "absent", "lost"]
MemberStep = Literal["heard", "gone", "back", "expired"]

MEMBER_TRANSITIONS: Final[Mapping[MemberState, Mapping[MemberStep, MemberState]]] = {
    "here": {"heard": "here", "gone": "absent", "back": "here", "expired": "lost"},
    "absent": {"heard": "absent", "gone": "absent", "back": "here", "expired": "lost"},
    "lost": {"heard": "here", "gone": "lost", "back": "lost", "expired": "lost"},
}
"""Whether a worker is there -> what happens -> whether it is there then."""


@dataclass(slots=True)
class Member:
    """One worker process."""

    hello: Hello
    state: MemberState
    heard_at: float
    gone_at: float | None = None
    status: WorkerStatus | None = None

    def step(self, step: MemberStep) -> None:
        """Go to the next state by the table."""
        self.state = MEMBER_TRANSITIONS[self.state][step]

    @property
    def is_ready(self) -> bool:
        """Whether islands can be placed there now."""
        return self.state == "here" and self.status is not None and self.status.state not in ("compiling", "leaving")

    @property
    def is_leaving(self) -> bool:
        """Whether it has said that it will end soon."""
        return self.status is not None and self.status.state == "leaving"


class Membership:
    """All workers by name."""

    def __init__(self) -> None:
        self._members: dict[str, Member] = {}
        self._looked_at: float | None = None

    def greet(self, hello: Hello, now: float) -> str | None:
        """Take in a worker; return a sentence instead when it must be refused."""
        refusal = version_refusal(hello) or self._name_refusal(hello) or self._fingerprint_refusal(hello)
        if refusal is not None:
            return refusal
        if self.is_new(hello):
            self._members[hello.name] = Member(hello, "here", now)
        else:
            known = self._members[hello.name]
            known.hello, known.heard_at = hello, now
        return None

    def hear(self, worker: str, status: WorkerStatus, now: float) -> bool:
        """Take in a heartbeat; return False when this process is not known."""
        member = self._members.get(worker)
        if member is None or member.hello.instance != status.instance:
            return False
        member.step("heard")
        member.status, member.heard_at = status, now
        return True

    def see(self, worker: str, present: bool, now: float) -> None:
        """Take in that a worker's presence came or went."""
        member = self._members.get(worker)
        if member is None:
            return
        if present:
            member.step("back")
        elif member.state == "here":
            member.step("gone")
            member.gone_at = now

    def expire(self, now: float) -> list[str]:
        """Return the workers that are lost since the last look."""
        if self._looked_at is not None and now - self._looked_at > GAP_S:
            self.renew(now)
        self._looked_at = now
        lost = [name for name, member in self._members.items() if self._is_overdue(member, now)]
        for name in lost:
            self._members[name].step("expired")
        for name in [
            name for name, each in self._members.items() if each.state == "lost" and now - each.heard_at > FORGET_S
        ]:
            del self._members[name]
        return lost

    def renew(self, now: float) -> None:
        """Give everybody a fresh lease: the coordinator could not have heard them."""
        for member in self._members.values():
            member.heard_at = now
            if member.gone_at is not None:
                member.gone_at = now

    def ready(self) -> tuple[str, ...]:
        """Return the workers that can compute islands, sorted."""
        return tuple(sorted(name for name, member in self._members.items() if member.is_ready))

    def arriving(self) -> int:
        """Return how many workers are there but not ready yet."""
        return sum(
            member.state == "here" and not member.is_ready and not member.is_leaving
            for member in self._members.values()
        )

    def is_lost(self, worker: str) -> bool:
        """Tell whether islands placed on this worker have nobody to compute them."""
        member = self._members.get(worker)
        return member is None or member.state == "lost"

    def is_leaving(self, worker: str) -> bool:
        """Tell whether this worker has said that it will end soon."""
        member = self._members.get(worker)
        return member is not None and member.is_leaving

    def is_new(self, hello: Hello) -> bool:
        """Tell whether this process has not borne its name before."""
        member = self._members.get(hello.name)
        return member is None or member.hello.instance != hello.instance

    def views(self, now: float) -> tuple[WorkerView, ...]:
        """Return what people are shown, sorted by name."""
        return tuple(_view(name, self._members[name], now) for name in sorted(self._members))

    def _is_overdue(self, member: Member, now: float) -> bool:
        if member.state == "absent":
            return member.is_leaving or now - (member.gone_at or 0.0) >= ABSENCE_S
        return member.state == "here" and now - member.heard_at >= LEASE_S

    def _name_refusal(self, hello: Hello) -> str | None:
        known = self._members.get(hello.name)
        if known is None or known.hello.instance == hello.instance or known.state != "here":
            return None
        return (
            f"a worker named {hello.name!r} is already connected from {known.hello.host} (process {known.hello.pid}); "
            "give this one another name with --name"
        )

    def _fingerprint_refusal(self, hello: Hello) -> str | None:
        """Refuse kernels other than those of the workers that are here: they might give other bits."""
        for name, member in self._members.items():
            other = member.hello.fingerprint
            if member.state == "lost" or name == hello.name or not (other and hello.fingerprint):
                continue
            if other != hello.fingerprint:
                return (
                    f"worker {hello.name!r} computes with kernels {hello.fingerprint}, but the other workers with "
                    f"{other}; install the same version {VERSION} of Atoll on all of them"
                )
        return None


def version_refusal(hello: Hello) -> str | None:
    """Return a sentence naming both sides' versions when they do not fit; clients need the same protocol only."""
    ours = f"Atoll {VERSION} (protocol {PROTOCOL_VERSION}, engine {ENGINE_REVISION})"
    theirs = f"Atoll {hello.version} (protocol {hello.protocol}, engine {hello.engine})"
    fits = hello.protocol == PROTOCOL_VERSION
    if hello.role == "worker":
        fits = fits and hello.version == VERSION and hello.engine == ENGINE_REVISION
    if fits:
        return None
    return f"this {hello.role} is {theirs}, but the coordinator is {ours}; install the same version on both sides"


def _view(name: str, member: Member, now: float) -> WorkerView:
    status = member.status
    state: WorkerState = "lost" if member.state == "lost" else (status.state if status else "compiling")
    return WorkerView(
        worker=name,
        host=member.hello.host,
        pid=member.hello.pid,
        state=state,
        islands=sum(each.islands for each in status.holdings) if status and state != "lost" else 0,
        silent=max(0.0, now - member.heard_at),
        version=member.hello.version,
        detail=status.detail if status else "",
    )
