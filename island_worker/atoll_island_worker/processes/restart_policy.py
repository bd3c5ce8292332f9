"""The lives that one worker's process leads, one after the other: whether there is another, and when. Pure."""

from collections.abc import Mapping
from typing import Final, Literal

from atoll.errors import LocalProtocolError

FIRST_PAUSE_S: Final = 1.0
MOST_PAUSE_S: Final = 30.0
STEADY_S: Final = 60.0
"""A life that lasts so long says that the ones before it ended by chance."""

MOST_DEATHS: Final = 5
"""So many deaths within `STEADY_S`, and there is no further life."""

ENDS: Final = frozenset({0, 3, 130})
"""Exit codes of lives that end in order, or for a reason that another one meets as well."""

REFUSED: Final = 2
"""Exit code of a process that is refused; after a first life that only means that its name is not free yet."""

LifeState = Literal["alive", "paused", "over"]
LifeStep = Literal["died", "due", "ended", "told"]

LIFE_TRANSITIONS: Final[Mapping[LifeState, Mapping[LifeStep, LifeState]]] = {
    "alive": {"died": "paused", "ended": "over", "told": "alive"},
    "paused": {"due": "alive", "told": "over"},
    "over": {"told": "over"},
}
"""Whether a process is there -> what happens -> whether it is there then. `died`: it is to be started again; `ended`:
it is not; `told`: all are to end."""


class Lives:
    """The lives of one process. `code` is the exit code of the last one that ended."""

    def __init__(self) -> None:
        self.state: LifeState = "paused"
        self.due_at = 0.0
        self.code = 0
        self.number = 0
        self._began_at = 0.0
        self._in_a_row = 0
        self._deaths: list[float] = []
        self._is_told = False

    @property
    def deaths(self) -> int:
        """How many deaths there were lately."""
        return len(self._deaths)

    @property
    def is_given_up(self) -> bool:
        """Whether it dies too often to be started again."""
        return self.state == "over" and self.deaths >= MOST_DEATHS

    def begin(self, now: float) -> None:
        """Note that the process is started."""
        self._step("due")
        self.number += 1
        self._began_at = now

    def end(self, code: int, now: float) -> float | None:
        """Note that the process has ended; return for how many seconds to wait before it is started again.

        None: it is not, since it ended in order, since all were told to end, or since it dies too often.
        """
        self.code = code
        is_final = self._is_told or code in ENDS or (code == REFUSED and self.number == 1)
        if now - self._began_at >= STEADY_S:
            self._in_a_row = 0
        self._in_a_row += 1
        self._deaths = [at for at in self._deaths if now - at < STEADY_S] + ([] if is_final else [now])
        if is_final or len(self._deaths) >= MOST_DEATHS:
            self._step("ended")
            return None
        self._step("died")
        pause_s: float = min(MOST_PAUSE_S, FIRST_PAUSE_S * 2.0 ** (self._in_a_row - 1))
        self.due_at = now + pause_s
        return pause_s

    def tell(self) -> None:
        """Note that all are to end: there is no further life."""
        self._is_told = True
        if self.state == "paused":
            self.code = 0
        self._step("told")

    def _step(self, step: LifeStep) -> None:
        following = LIFE_TRANSITIONS[self.state].get(step)
        if following is None:
            raise LocalProtocolError(f"a process that is {self.state} has no {step}")
        self.state = following
