"""Islands that kill whoever computes them: how many deaths, and what follows. Pure.

A death counts for each archipelago that the dead worker had islands of, and one for each of its terms at most: a host
that loses its power takes many workers at once, which says nothing about their islands. An archipelago that has cost
three terms without a commit between is isolated: one worker computes it, and nothing else. Two more, and its job fails.
Innocent ones that shared a worker with it are isolated as well; they commit, and are free again.
"""

from collections.abc import Mapping
from typing import Final, Literal

from atoll.errors import LocalProtocolError

PoisonState = Literal["sound", "once", "twice", "isolated", "again", "condemned"]
PoisonStep = Literal["death", "pardon", "commit"]

POISON_TRANSITIONS: Final[Mapping[PoisonState, Mapping[PoisonStep, PoisonState]]] = {
    "sound": {"death": "once", "commit": "sound"},
    "once": {"death": "twice", "pardon": "sound", "commit": "sound"},
    "twice": {"death": "isolated", "pardon": "once", "commit": "sound"},
    "isolated": {"death": "again", "pardon": "twice", "commit": "sound"},
    "again": {"death": "condemned", "pardon": "isolated", "commit": "sound"},
    "condemned": {},
}
"""What is thought of an archipelago -> what happens -> what is thought then. `pardon`: a worker that was taken for dead
came back as the same process."""

Dead = tuple[str, str]
"""Name and instance of a worker process."""


class Suspicion:
    """What is thought of one archipelago."""

    def __init__(self) -> None:
        self.state: PoisonState = "sound"
        self._counted: dict[int, set[Dead]] = {}
        self._committed = 0

    @property
    def is_isolated(self) -> bool:
        """Whether it may not share a worker with others."""
        return self.state in ("isolated", "again")

    def died(self, term: int, dead: Dead) -> bool:
        """Note that a worker died which had islands under that term; return whether that counts."""
        counts = term not in self._counted and self.state != "condemned"
        if counts:
            self._step("death")
        if self.state != "condemned" or counts:
            self._counted.setdefault(term, set()).add(dead)
        return counts

    def counts(self, dead: Dead) -> bool:
        """Tell whether the death of a process has been noted."""
        return any(dead in those for those in self._counted.values())

    def came_back(self, dead: Dead) -> bool:
        """Note that a process lives after all; return whether a death is taken back by that."""
        terms = [term for term, those in self._counted.items() if those == {dead}]
        for those in self._counted.values():
            those.discard(dead)
        if self.state == "condemned":
            return False
        for term in terms:
            del self._counted[term]
            self._step("pardon")
        return bool(terms)

    def commits(self, epoch: int) -> bool:
        """Note a commit; return whether it is newer than all before (epochs are computed again after a death)."""
        is_newer = epoch > self._committed
        if is_newer and self.state != "condemned":
            self._committed = epoch
            self._counted.clear()
            self._step("commit")
        return is_newer

    def _step(self, step: PoisonStep) -> None:
        following = POISON_TRANSITIONS[self.state].get(step)
        if following is None:
            raise LocalProtocolError(f"an archipelago that is {self.state} has no {step}")
        self.state = following
