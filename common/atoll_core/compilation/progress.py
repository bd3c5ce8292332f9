"""The progress of compiling kernels: how much is done and how long it still takes, as a sentence and as a bar.

Kernels differ much in their cost, so their number says little about time. Each package has a table of the seconds that
its kernels took on one machine. The ratio of this machine's time to the time in the table, for the kernels compiled so
far, gives the remaining time. Only the sentence travels from a worker to its coordinator and to clients.
"""

import contextlib
import re
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

Report = Callable[[str], None]

INTERVAL_S: Final = 1.0
"""The time between two reports while a kernel is compiled."""

_COUNT: Final = re.compile(r"(\d+) of (\d+) compiled")
_LEFT: Final = re.compile(r"(\d+) s of (\d+) s left")


class RemainingTime:
    """How many kernels are compiled, and how long the others take. `costs` are their usual seconds, in order."""

    def __init__(self, costs: Sequence[float], clock: Callable[[], float] = time.monotonic) -> None:
        self.done = 0
        self._costs, self._clock = costs, clock
        self._begun = self._latest = clock()

    def add(self) -> None:
        """Count a kernel that is compiled."""
        self.done += 1
        self._latest = self._clock()

    def sentence(self) -> str:
        """Return the progress message."""
        kernels = len(self._costs)
        if self.done >= kernels:
            return sentence_of(kernels, kernels)
        spent = sum(self._costs[: self.done])
        pace = (self._latest - self._begun) / spent if spent else 1.0
        after = pace * sum(self._costs[self.done + 1 :])  # the time for the kernels after the present one
        present = pace * self._costs[self.done] - (self._clock() - self._latest)
        return sentence_of(self.done, kernels, max(1.0, after + max(0.0, present)), pace * sum(self._costs))


def sentence_of(done: int, kernels: int, left: float = 0.0, whole: float = 0.0) -> str:
    """Return the progress message for `done` of all `kernels`: of `whole` seconds, `left` remain (0: not known)."""
    time_left = f", {left:.0f} s of {max(left, whole):.0f} s left" if left else ""
    return f"compiling kernels, only once on this machine: {done} of {kernels} compiled{time_left}"


def count_of(sentence: str) -> tuple[int, int] | None:
    """Return the numbers of compiled kernels and of all kernels in a progress message; None if it has no numbers."""
    match = _COUNT.search(sentence)
    return (int(match[1]), int(match[2])) if match else None


def share_of(sentence: str) -> float | None:
    """Return which share of the work is done, by time if the message has a time; None if it has no numbers."""
    times, count = _LEFT.search(sentence), count_of(sentence)
    if times:
        return 1.0 - int(times[1]) / int(times[2])
    return count[0] / max(1, count[1]) if count else None


@contextlib.contextmanager
def reporting(
    costs: Sequence[float], on_ready: list[Callable[[], None]], report: Report, interval: float = INTERVAL_S
) -> Iterator[None]:
    """Report how many kernels are compiled: at the beginning, after each kernel, every second, and at the end.

    `on_ready` takes the function that counts. Reports come from two threads, one after the other.
    """
    estimate, lock, ended = RemainingTime(costs), threading.Lock(), threading.Event()

    def count() -> None:
        with lock:
            estimate.add()
            if estimate.done < len(costs):  # the last count is reported below, since some kernels may be ready before
                report(estimate.sentence())

    def repeat() -> None:
        while not ended.wait(interval):
            with lock:
                report(estimate.sentence())

    report(estimate.sentence())
    thread = threading.Thread(target=repeat, name="compiling", daemon=True)
    thread.start()
    on_ready.append(count)
    try:
        yield
    finally:
        on_ready.remove(count)
        ended.set()
        thread.join()
    report(sentence_of(len(costs), len(costs)))


class WarmUpDisplay:
    """Shows the messages of warm-ups on stderr: progress bars on a terminal, else the first and the last count only."""

    def __init__(self) -> None:
        self._bars: Progress | None = None
        self._tasks: dict[str, TaskID] = {}
        self._written: set[tuple[str, int]] = set()

    def __call__(self, sentence: str, of: str = "") -> None:
        """Show a message; `of` names one of several warm-ups."""
        done, kernels = count_of(sentence) or (0, 0)
        if kernels and sys.stderr.isatty():
            self._draw(sentence, of)
        elif not kernels or (done in (0, kernels) and (of, done) not in self._written):
            self._written |= {(of, done)} if kernels else set()
            sys.stderr.write(f"{of}: {sentence}\n" if of else f"{sentence}\n")

    def _draw(self, sentence: str, of: str) -> None:
        if self._bars is None:
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn

            self._bars = Progress(
                TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[left]}"),
                console=Console(stderr=True),
            )  # fmt: skip
            self._bars.start()
        share, times = share_of(sentence) or 0.0, _LEFT.search(sentence)
        left = f"{times[1]} s left" if times else ""
        if of not in self._tasks:
            description = f"compiling kernels, only once {of}".strip()
            self._tasks[of] = self._bars.add_task(description, total=1.0, left=left)
        self._bars.update(self._tasks[of], completed=share, left=left, refresh=True)
        if self._bars.finished:
            self._bars.stop()
            self._bars = None
            self._tasks.clear()
