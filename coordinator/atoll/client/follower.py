"""Following a job to its end: ask, show, wait. What shows it is passed in."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Final, Self

from atoll.client.client import Client
from atoll_core.errors import UnreachableError
from atoll_core.wire.messages.views import FINAL_STATES, JobView, WorkerView

PATIENCE_S: Final = 30.0
"""How long a coordinator that stopped answering is waited for."""

_FIRST_INTERVAL_S: Final = 0.05
_LAST_INTERVAL_S: Final = 0.3


class Display:
    """Shows a job's progress, this one nothing; a context manager."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        return

    def show(self, view: JobView, workers: Sequence[WorkerView], now: float) -> None:
        """Take notice of the latest state, seen at monotonic second `now`."""

    def print_note(self, sentence: str) -> None:
        """Show a sentence that stays."""


class Follower:
    """Follows one job through a client. Before every question `check` returns sentences to show, or raises."""

    def __init__(self, client: Client, job: str, display: Display, check: Callable[[], Sequence[str]] = tuple) -> None:
        self.job = job
        self.phases: dict[str, float] = defaultdict(float)
        """Seconds spent in each phase of the job, as seen while following it."""
        self._client = client
        self._display = display
        self._check = check
        self._seen_at: float | None = None
        self._silent_since: float | None = None
        self._warned: set[str] = set()

    def follow(self) -> JobView:
        """Return the final state of the job; raises UnreachableError after a silence of `PATIENCE_S` seconds."""
        interval = _FIRST_INTERVAL_S
        while True:
            for sentence in self._check():
                self._display.print_note(sentence)
            view = self._ask()
            if view is not None and view.state in FINAL_STATES:
                return view
            self._client.pause(interval)
            interval = min(_LAST_INTERVAL_S, interval * 1.05)

    def _ask(self) -> JobView | None:
        try:
            view, workers = self._client.status(self.job), self._client.workers()
        except UnreachableError as error:
            self._tolerate_silence(error)
            return None
        self._silent_since = None
        for warning in view.warnings:
            if warning not in self._warned:
                self._warned.add(warning)
                self._display.print_note(f"note: {warning}")
        now = self._client.now()
        if self._seen_at is not None:
            self.phases[phase(view, workers)] += now - self._seen_at
        self._seen_at = now
        self._display.show(view, workers, now)
        return view

    def _tolerate_silence(self, error: UnreachableError) -> None:
        """Take in that the coordinator is silent; raise UnreachableError when it is so for too long."""
        now = self._client.now()
        if self._silent_since is None:
            self._silent_since = now
            self._display.print_note(f"the coordinator does not answer; waiting another {PATIENCE_S:.0f} s for it")
        elif now - self._silent_since > PATIENCE_S:
            raise UnreachableError(f"{error}; the job may go on there: coordinator status {self.job}") from error


def phase(view: JobView, workers: Sequence[WorkerView]) -> str:
    """Return what the time goes into: starting, compiling or loading kernels, preparing, searching, refining."""
    if view.state == "refining":
        return "refining"
    if any(variable.epoch for variable in view.variables):
        return "searching"
    busy = [worker for worker in workers if worker.state == "compiling"]
    if busy:
        return "compiling kernels" if any("compiling" in worker.detail for worker in busy) else "loading kernels"
    if view.state == "running":
        return "searching"
    return "preparing" if any(worker.state != "lost" for worker in workers) else "starting"
