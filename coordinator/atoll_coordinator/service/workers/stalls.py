"""Finds why an archipelago makes no progress, from its placement, its reports and the states of workers. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

from atoll_coordinator.service.search.archipelago import Archipelago, ArchipelagoKey
from atoll_coordinator.service.workers.membership import Membership, RegisteredWorker

Cause = Literal[
    "silence", "absence", "compiling", "not taken up", "lost report", "standing", "others", "migrants", "slow"
]

PATIENCE_S: Final[dict[Cause, float]] = {
    "silence": 5.0, "absence": 3.0, "compiling": 5.0, "not taken up": 5.0, "lost report": 5.0, "standing": 10.0,
    "others": 30.0, "migrants": 5.0, "slow": 60.0,
}  # fmt: skip
"""Seconds for which the lack of progress and its cause must last to be a stall. The first cause in this order counts:
it may be the reason of later causes."""

_SILENT_S: Final = 3.0
_STANDING_S: Final = 5.0
_MOST_NAMED: Final = 4


@dataclass(frozen=True, slots=True)
class Stall:
    """An archipelago that waits until `islands` on `worker` report `epoch`; the cause has lasted for `seconds`."""

    cause: Cause
    worker: str
    islands: tuple[int, ...]
    epoch: int
    term: int
    seconds: float
    sentence: str


def stall_of(archipelago: Archipelago, membership: Membership, still_s: float) -> Stall | None:
    """Return why no further epoch of an archipelago is complete; None: this is not a stall.

    Args:
        archipelago: it can stall only if it is placed and not cut.
        membership: the workers, at the time of the last check.
        still_s: seconds since an epoch was completed, or since the placement.
    """
    placement = archipelago.placement
    if placement is None or archipelago.cut is not None or still_s < min(PATIENCE_S.values()):
        return None
    awaited = archipelago.collector.awaited()
    workers = sorted({placement.workers[island] for island in awaited if island < len(placement.workers)})
    stalls = [
        _stall(archipelago, worker, tuple(i for i in awaited if placement.workers[i] == worker), membership, still_s)
        for worker in workers
    ]
    lasting = [stall for stall in stalls if min(still_s, stall.seconds) >= PATIENCE_S[stall.cause]]
    return min(lasting, key=lambda stall: (list(PATIENCE_S).index(stall.cause), stall.worker), default=None)


def _stall(
    archipelago: Archipelago, worker: str, islands: tuple[int, ...], membership: Membership, still_s: float
) -> Stall:
    placement = archipelago.placement
    assert placement is not None
    epoch, member = archipelago.collector.state.epochs, membership.member(worker)
    waits = f"waiting for {named(islands)} on worker {worker}"
    cause, words, seconds = _cause(archipelago, member, membership.checked_at, epoch, still_s)
    sentence = {
        "lost report": f"waiting for the report of epoch {epoch} from worker {worker}",
        "not taken up": f"waiting for worker {worker} to take up {named(islands)} under term {placement.term}",
        "standing": f"computing slowly: {words} on worker {worker}, {seconds:.0f} s without progress",
        "slow": f"computing slowly: {named(islands)} on worker {worker}, epoch {epoch}, for {seconds:.0f} s",
    }.get(cause, f"{waits}, {words}")
    return Stall(cause, worker, islands, epoch, placement.term, seconds, sentence)


def _cause(
    archipelago: Archipelago, member: RegisteredWorker | None, now: float, epoch: int, still_s: float
) -> tuple[Cause, str, float]:
    """Return the cause, a text about it, and the seconds for which it has lasted."""
    if member is None or member.state == "absent":
        gone = now - (member.gone_at or now) if member is not None else still_s
        return "absence", f"whose connection has been lost for {gone:.0f} s", gone
    silent = now - member.heard_at
    if silent >= _SILENT_S or member.status is None:
        return "silence", f"silent for {silent:.0f} s", silent
    status = member.status
    if status.state == "compiling":
        return "compiling", "which loads or compiles its kernels", still_s
    placement, standing = archipelago.placement, now - member.progressed_at
    held = next((h for h in status.holdings if (h.job, h.variable) == (archipelago.job, archipelago.variable)), None)
    if held is None or placement is None or held.term != placement.term:
        return "not taken up", "", still_s
    if held.reported > epoch:
        return "lost report", "", still_s
    doing = status.doing
    if doing is None:
        return "migrants", f"which waits for migrants itself ({status.state})", still_s
    at = f"island {doing.island}, epoch {doing.epoch}"
    if standing >= _STANDING_S:
        owner = "" if doing.job == archipelago.job else f" of job {doing.job}"
        return "standing", f"{at}{owner}", standing
    if doing.job != archipelago.job:
        return "others", f"which computes job {doing.job} in turn", still_s
    return "slow", "", still_s


def named(islands: Sequence[int]) -> str:
    """Return a text with the numbers of islands."""
    shown = ", ".join(str(island) for island in islands[:_MOST_NAMED])
    more = f" and {len(islands) - _MOST_NAMED} more" if len(islands) > _MOST_NAMED else ""
    return f"island {shown}" if len(islands) == 1 else f"islands {shown}{more}"


class StallDetector:
    """Finds stalls, and stores the time of the last progress of each archipelago."""

    def __init__(self, membership: Membership) -> None:
        self._membership = membership
        self._marks: dict[ArchipelagoKey, tuple[tuple[int, int], float]] = {}
        self._stalls: dict[ArchipelagoKey, Stall] = {}

    def check(self, archipelagos: Sequence[Archipelago], now: float) -> list[tuple[ArchipelagoKey, Stall | None]]:
        """Return stalls that are new or have another cause, and None for each archipelago whose stall has ended."""
        changes: list[tuple[ArchipelagoKey, Stall | None]] = []
        for archipelago in archipelagos:
            key, before = archipelago.key, self._stalls.pop(archipelago.key, None)
            stall = stall_of(archipelago, self._membership, self._still_s(archipelago, now))
            if stall is not None:
                self._stalls[key] = stall
            if (stall and (stall.cause, stall.worker)) != (before and (before.cause, before.worker)):
                changes.append((key, stall))
        open_keys = {archipelago.key for archipelago in archipelagos}
        self._stalls = {key: stall for key, stall in self._stalls.items() if key in open_keys}
        self._marks = {key: mark for key, mark in self._marks.items() if key in open_keys}
        return changes

    def sentences(self, job: str) -> tuple[str, ...]:
        """Return sentences about the stalls of a job, by variable."""
        return tuple(f"{key[1]}: {stall.sentence}" for key, stall in sorted(self._stalls.items()) if key[0] == job)

    def _still_s(self, archipelago: Archipelago, now: float) -> float:
        """Return the seconds since the term or the number of complete epochs of an archipelago changed."""
        term = archipelago.placement.term if archipelago.placement is not None else 0
        mark = (term, archipelago.collector.state.epochs)
        before, since = self._marks.get(archipelago.key, (None, now))
        self._marks[archipelago.key] = (mark, since if before == mark else now)
        return now - self._marks[archipelago.key][1]
