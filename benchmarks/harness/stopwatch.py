"""How long a job was in each of its states, what that took, and an end to it when it takes too long."""

import os
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from atoll_core.wire.messages.views import FINAL_STATES, JobView

JOB_LIMIT_S: Final = 1800.0
"""No job of these benchmarks takes longer, whatever it does."""


@dataclass
class Stopwatch:
    """Takes the time of one job; `watch` is called several times a second.

    `seconds` are those in which the job was seen in each state. With `counts`, `processor` are the seconds that all
    processes below this one, and those of theirs that have ended, computed in these, where /proc tells.
    """

    limit_s: float = JOB_LIMIT_S
    counts: bool = False
    seconds: dict[str, float] = field(default_factory=dict)
    processor: dict[str, float] = field(default_factory=dict)
    _begun: float = field(default_factory=time.monotonic)
    _last: float | None = None
    _last_processor: float = 0.0

    def watch(self, view: JobView) -> None:
        """Add the time since the last look to the job's state; raises TimeoutError when it takes too long."""
        now, processor = time.monotonic(), processor_seconds() if self.counts else 0.0
        if self._last is not None and view.state not in FINAL_STATES:
            self.seconds[view.state] = self.seconds.get(view.state, 0.0) + now - self._last
            if self.counts:
                used = max(processor - self._last_processor, 0.0)
                self.processor[view.state] = self.processor.get(view.state, 0.0) + used
        self._last, self._last_processor = now, processor
        if now - self._begun > self.limit_s:
            raise TimeoutError(f"it was still {view.state} after {self.limit_s:.0f} s")


def processor_seconds() -> float:
    """Return the processor seconds of all processes below this one, and of those of theirs that have ended."""
    parents: dict[int, int] = {}
    ticks: dict[int, int] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            state = (folder / "stat").read_text("utf-8").rpartition(")")[2].split()
            ticks[int(folder.name)] = sum(map(int, state[11:15]))
            parents[int(folder.name)] = int(state[1])
        except (OSError, IndexError, ValueError):
            continue
    below, spent = {os.getpid()}, 0
    while children := {pid for pid, parent in parents.items() if parent in below and pid not in below}:
        spent += sum(ticks[pid] for pid in children)
        below |= children
    return spent / os.sysconf("SC_CLK_TCK")
