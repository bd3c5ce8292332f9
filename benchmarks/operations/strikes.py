"""What strikes a program on a machine of its own, whom and when, drawn from a seed; and what came of it."""

import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

from atoll_core.errors import UsageError
from atoll_core.search.seeding import Stream, stream_key
from atoll_core.wire.messages.views import JobView
from benchmarks.harness.service import COORDINATOR, ROUTER, Machines

Kind = Literal[
    "kill-worker", "stop-worker", "kill-coordinator", "stop-coordinator", "kill-router", "stop-router", "cut-worker"
]

LASTING_S: Final[Mapping[Kind, tuple[float, float]]] = {
    "kill-worker": (0.0, 3.0),
    "stop-worker": (0.5, 30.0),
    "kill-coordinator": (0.0, 3.0),
    "stop-coordinator": (0.5, 8.0),
    "kill-router": (0.0, 3.0),
    "stop-router": (0.5, 8.0),
    "cut-worker": (0.5, 20.0),
}
"""For how long a program is away, in seconds: the least and the most."""


@dataclass(frozen=True, slots=True)
class Strike:
    """One blow: `kind`, the program `who`, and after how many seconds it is undone."""

    kind: Kind
    who: str
    for_s: float

    def carry_out(self, machines: Machines) -> None:
        """Strike."""
        self._ways(machines)[0](self.who)

    def undo(self, machines: Machines) -> None:
        """Start again who was killed, let go on who was stopped, mend the line."""
        self._ways(machines)[1](self.who)

    def _ways(self, machines: Machines) -> tuple[Callable[[str], None], Callable[[str], None]]:
        if self.kind.startswith("kill"):
            return machines.kill, machines.start
        if self.kind.startswith("stop"):
            return machines.stop, machines.resume
        return machines.cut, machines.heal


class Strikes:
    """The strikes of a campaign, one after the other."""

    def __init__(self, seed: int, kinds: Sequence[Kind], workers: Sequence[str]) -> None:
        self._stream = Stream(stream_key(seed, "", -1, 0, "strikes"))
        self._kinds = tuple(kinds)
        self._workers = tuple(workers)

    def next(self) -> Strike:
        """Return the next one."""
        kind = self._kinds[self._stream.below(len(self._kinds))]
        low, high = LASTING_S[kind]
        who = kind.partition("-")[2]
        if who not in (COORDINATOR, ROUTER):
            who = self._workers[self._stream.below(len(self._workers))]
        return Strike(kind, who, self.between(low, high))

    def between(self, low_s: float, high_s: float) -> float:
        """Return a number of seconds."""
        return low_s + (high_s - low_s) * self._stream.uniform()


@dataclass(frozen=True)
class Blow:
    """A strike as it happened. `lost_s`: for how long the search of any equation stood still, less a usual epoch."""

    kind: Kind
    who: str
    for_s: float
    job: str
    at_s: float
    lost_s: float


@dataclass
class Standing:
    """How far the searches of a job are: epochs by equation, and which are over."""

    epochs: dict[str, int]
    over: set[str]

    @classmethod
    def of(cls, view: JobView) -> "Standing":
        """Return that of a job's view."""
        is_over = view.state not in ("running", "preparing")
        over = {variable.variable for variable in view.variables if variable.finished or is_over}
        return cls({variable.variable: variable.epoch for variable in view.variables}, over)

    def is_passed_by(self, later: "Standing") -> bool:
        """Tell whether every search that was under way has got further since, or is over."""
        return all(
            variable in later.over or later.epochs.get(variable, -1) > epoch for variable, epoch in self.epochs.items()
        )


def kinds_of(names: Iterable[str]) -> tuple[Kind, ...]:
    """Return the kinds of these names; raises UsageError for one that there is not."""
    unknown = sorted(set(names) - set(LASTING_S))
    if unknown:
        raise UsageError(f"--kinds: {', '.join(LASTING_S)} were expected, but {unknown[0]!r} was given")
    return tuple(kind for kind in LASTING_S if kind in set(names))


def rows(blows: Sequence[Blow]) -> list[tuple[str, ...]]:
    """Return for each kind, and for all, how many there were and the median and worst time lost."""
    groups = [(str(kind), [blow for blow in blows if blow.kind == kind]) for kind in LASTING_S]
    return [_row(name, group) for name, group in [*groups, ("all", list(blows))] if group]


def _row(name: str, blows: Sequence[Blow]) -> tuple[str, ...]:
    lost = [blow.lost_s for blow in blows]
    longest = max(blow.for_s for blow in blows)
    return name, str(len(blows)), f"{statistics.median(lost):.2f}", f"{max(lost):.2f}", f"{longest:.1f}"
