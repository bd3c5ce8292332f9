"""Whether a worker's process that has ended is started again, and when. Pure."""

from collections.abc import Mapping
from typing import Final, Literal

from atoll_core.errors import LocalProtocolError

FIRST_PAUSE_S: Final = 1.0
MOST_PAUSE_S: Final = 30.0
STEADY_S: Final = 60.0
"""A process that runs so long has its next pause begin at the first one again."""

MOST_DEATHS: Final = 5
"""After so many deaths within `STEADY_S` it is not started again."""

ENDS: Final = frozenset({0, 3, 130})
"""Exit codes of processes that end in order, or for a reason that another one would meet as well."""

REFUSED: Final = 2
"""Exit code of a process that is refused; after a first one that only means that its name is not free yet."""

ProcessState = Literal["running", "paused", "ended"]
ProcessStep = Literal["died", "due", "finished", "stop"]

PROCESS_TRANSITIONS: Final[Mapping[ProcessState, Mapping[ProcessStep, ProcessState]]] = {
    "running": {"died": "paused", "finished": "ended", "stop": "running"},
    "paused": {"due": "running", "stop": "ended"},
    "ended": {"stop": "ended"},
}
"""State of a process -> what happens -> its next state. `died`: it is to be started again; `finished`: it is not;
`stop`: all are to end."""


class RestartPolicy:
    """Restarts of one worker's process. `code` is the last exit code, `number` counts the starts."""

    def __init__(self) -> None:
        self.state: ProcessState = "paused"
        self.due_at = 0.0
        self.code = 0
        self.number = 0
        self._began_at = 0.0
        self._in_a_row = 0
        self._deaths: list[float] = []
        self._is_stopped = False

    @property
    def deaths(self) -> int:
        """How many deaths there were lately."""
        return len(self._deaths)

    @property
    def is_given_up(self) -> bool:
        """Whether it dies too often to be started again."""
        return self.state == "ended" and self.deaths >= MOST_DEATHS

    def begin(self, now: float) -> None:
        """Record a start."""
        self._step("due")
        self.number += 1
        self._began_at = now

    def end(self, code: int, now: float) -> float | None:
        """Record an end; return for how many seconds to wait before the process is started again.

        None: it is not, since it ended in order, since all are to end, or since it dies too often.
        """
        self.code = code
        is_final = self._is_stopped or code in ENDS or (code == REFUSED and self.number == 1)
        if now - self._began_at >= STEADY_S:
            self._in_a_row = 0
        self._in_a_row += 1
        self._deaths = [at for at in self._deaths if now - at < STEADY_S] + ([] if is_final else [now])
        if is_final or len(self._deaths) >= MOST_DEATHS:
            self._step("finished")
            return None
        self._step("died")
        pause_s: float = min(MOST_PAUSE_S, FIRST_PAUSE_S * 2.0 ** (self._in_a_row - 1))
        self.due_at = now + pause_s
        return pause_s

    def stop(self) -> None:
        """Have no further start: all are to end."""
        self._is_stopped = True
        if self.state == "paused":
            self.code = 0
        self._step("stop")

    def _step(self, step: ProcessStep) -> None:
        following = PROCESS_TRANSITIONS[self.state].get(step)
        if following is None:
            raise LocalProtocolError(f"a process that is {self.state} has no {step}")
        self.state = following
