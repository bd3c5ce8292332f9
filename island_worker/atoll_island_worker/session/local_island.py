"""One island of a shard: its states, and when it asks for what it waits for. Pure."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal

from atoll_core.errors import LocalProtocolError

IslandState = Literal["restoring", "ready", "computing", "waiting", "at barrier", "stopped"]
IslandStep = Literal["restore", "begin", "emigrate", "complete", "end", "reject", "reach barrier"]

ISLAND_TRANSITIONS: Final[Mapping[IslandState, Mapping[IslandStep, IslandState]]] = {
    "restoring": {"restore": "ready", "end": "stopped"},
    "ready": {"begin": "computing", "end": "stopped"},
    "computing": {"emigrate": "waiting", "end": "stopped", "reject": "waiting", "reach barrier": "at barrier"},
    "waiting": {"complete": "ready", "end": "stopped"},
    "at barrier": {"end": "stopped"},
    "stopped": {},
}
"""State of one island -> what happens -> its next state. `restoring`: its state is on its way; `computing`: it is in
the run queue; `at barrier`: it waits at a checkpoint for a placement. `end`: a hit here or elsewhere, or the last
epoch."""

PULL_AFTER_S: Final = 1.0
"""An island that has waited this long asks the senders; the pause doubles with every question."""

PULL_PAUSE_MAX_S: Final = 8.0


@dataclass(slots=True)
class LocalIsland:
    """One island computed here. `epoch` is the one it computes, or will begin; `needs` its sources once it waits."""

    index: int
    state: IslandState = "ready"
    epoch: int = 0
    needs: frozenset[int] = frozenset()
    pause_s: float = PULL_AFTER_S
    pull_at: float | None = None

    def step(self, step: IslandStep) -> None:
        """Go to the next state by the table; raises LocalProtocolError for a pair that is not in it."""
        following = ISLAND_TRANSITIONS[self.state].get(step)
        if following is None:
            raise LocalProtocolError(f"island {self.index} in epoch {self.epoch} cannot {step} while {self.state}")
        self.state = following

    def is_pull_due(self, now: float) -> bool:
        """Tell whether an island that waits is to ask now."""
        return self.pull_at is not None and now >= self.pull_at

    def schedule_pull(self, now: float) -> None:
        """Set when to ask: after the first pause at first, and after a longer one each time that has come."""
        if self.pull_at is None:
            self.pull_at = now + self.pause_s
        elif now >= self.pull_at:
            self.pause_s = min(2 * self.pause_s, PULL_PAUSE_MAX_S)
            self.pull_at = now + self.pause_s
