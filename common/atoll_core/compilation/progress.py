"""How far the compiling of kernels has got: as a sentence, read from one, and as a bar on a terminal."""

import re
import sys
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

_COUNT: Final = re.compile(r"(\d+) of (\d+) compiled")


def sentence_of(done: int, kernels: int) -> str:
    """Return the sentence for `done` of `kernels`."""
    return f"compiling kernels, only once on this machine: {done} of {kernels} compiled"


def count_of(sentence: str) -> tuple[int, int] | None:
    """Return how many kernels of how many a sentence names as compiled; None when it names no count."""
    match = _COUNT.search(sentence)
    return (int(match[1]), int(match[2])) if match else None


class WarmUpDisplay:
    """Shows the sentences of warm-ups on stderr: bars on a terminal, else only the first and the last of a count."""

    def __init__(self) -> None:
        self._bars: Progress | None = None
        self._tasks: dict[str, TaskID] = {}

    def __call__(self, sentence: str, of: str = "") -> None:
        """Show a sentence; `of` names one of several warm-ups."""
        done, kernels = count_of(sentence) or (0, 0)
        if kernels and sys.stderr.isatty():
            self._draw(done, kernels, of)
        elif done in (0, kernels):
            sys.stderr.write(f"{of}: {sentence}\n" if of else f"{sentence}\n")

    def _draw(self, done: int, kernels: int, of: str) -> None:
        if self._bars is None:
            from rich.console import Console
            from rich.progress import Progress

            self._bars = Progress(console=Console(stderr=True))
            self._bars.start()
        if of not in self._tasks:
            self._tasks[of] = self._bars.add_task(f"compiling kernels, only once {of}".strip(), total=kernels)
        self._bars.update(self._tasks[of], completed=done, refresh=True)
        if self._bars.finished:
            self._bars.stop()
            self._bars = None
            self._tasks.clear()
