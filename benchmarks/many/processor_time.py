"""Processor seconds of all processes below this one, by the state that a job is in, where /proc tells them."""

import os
from dataclasses import dataclass, field
from pathlib import Path

from atoll.wire.messages.views import FINAL_STATES, JobView


@dataclass
class ProcessorTime:
    """Takes the processor time of one job; `watch` is called several times a second."""

    seconds: dict[str, float] = field(default_factory=dict)
    _last: float | None = None

    def watch(self, view: JobView) -> None:
        """Add what was used since the last look to the state that the job is in."""
        now = _used()
        if self._last is not None and view.state not in FINAL_STATES:
            self.seconds[view.state] = self.seconds.get(view.state, 0.0) + max(now - self._last, 0.0)
        self._last = now


def _used() -> float:
    """Return the processor seconds of all processes below this one, and of those of theirs that have ended."""
    parents: dict[int, int] = {}
    ticks: dict[int, int] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            words = (folder / "stat").read_text("utf-8").rpartition(")")[2].split()
        except OSError:
            continue
        parents[int(folder.name)] = int(words[1])
        ticks[int(folder.name)] = sum(map(int, words[11:15]))
    below, found = {os.getpid()}, 0
    while children := {pid for pid, parent in parents.items() if parent in below and pid not in below}:
        found += sum(ticks[pid] for pid in children)
        below |= children
    return found / os.sysconf("SC_CLK_TCK")
