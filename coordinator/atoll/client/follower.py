"""Follows a job to its end by a subscription, which yields its changes in order and without gaps.

The coordinator sends changes to a key of this client while a lease lasts. The client takes the lease by a request with
the number of its last change, and the answer has all later changes. So the same request renews the lease, closes gaps,
and finds a restarted coordinator. A `Display` shows the progress.
"""

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Final, Self

from atoll.client.client import Client
from atoll_core.data.notes import with_kind
from atoll_core.errors import UnreachableError
from atoll_core.wire.messages.clients import JobChange
from atoll_core.wire.messages.views import FINAL_STATES, JobView, Workforce

QUIET_S: Final = 2.0
"""Seconds without a change until the next request: a change may be lost, or the coordinator may have ended."""

RENEWED_AT: Final = 1.0 / 3.0
"""Share of a lease after which it is renewed, so that two renewals may be lost."""


class Subscription:
    """Changes of one job (None: of all jobs) from now on, or from the event after the number `after`."""

    def __init__(self, client: Client, job: str | None, after: int | None = None) -> None:
        """Set up; the first `wait` sends the first request. If `after` is None, earlier events are left out."""
        self._client = client
        self._job = job
        self._after = after
        self._sequence = 0
        self._ask_at = 0.0
        self._lease_ends = 0.0
        self._is_behind = True

    def wait(self, limit_s: float) -> JobChange | None:
        """Return the next change; None if none comes within `limit_s` seconds.

        Raises UnreachableError if the coordinator does not answer, RefusedError if it does not know the job.
        """
        end = self._client.now() + limit_s
        while True:
            now = self._client.now()
            if self._is_behind or now >= min(self._ask_at, self._lease_ends):
                change = self._ask()
                if change is not None:
                    return change
            change = self._client.next_change(max(0.0, min(end, self._ask_at) - now))
            if change is not None and self._is_next(change):
                return self._accept(change)
            if self._client.now() >= end:
                return None

    def _ask(self) -> JobChange | None:
        self._is_behind = True  # also without an answer
        answer = self._client.follow(self._job, self._after, self._sequence)
        self._is_behind = False
        now = self._client.now()
        self._ask_at, self._lease_ends = now + QUIET_S, now + RENEWED_AT * answer.lease_s
        return self._accept(answer.change) if answer.change is not None else None

    def _is_next(self, change: JobChange) -> bool:
        """Return whether this is the next change; after a gap, the missed changes are requested."""
        if change.job != self._job or change.sequence <= self._sequence:
            return False
        self._is_behind = change.previous != self._sequence
        return not self._is_behind

    def _accept(self, change: JobChange) -> JobChange:
        self._sequence, self._is_behind = change.sequence, change.has_more
        self._ask_at = self._client.now() + QUIET_S
        if self._after is None:
            return change
        events = tuple(
            event for event in change.events if event.number > self._after
        )  # the last answer already had the earlier events
        self._after = max(self._after, change.last)
        return change.model_copy(update={"events": events})


PATIENCE_S: Final = 30.0
"""Longest silence of a coordinator, in seconds."""

KEEPING: Final = "interrupted: keeping the best equations so far; Ctrl-C again ends at once"
"""The sentence that a display prints after Ctrl-C."""

_LOOK_S: Final = 0.3
"""Interval of calls of `check` and of updates of the elapsed time, in seconds."""


class Display:
    """Shows a job's progress; this base class shows nothing. A context manager."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        return

    def show(self, view: JobView, workforce: Workforce, now: float) -> None:
        """Show the latest state, observed at monotonic second `now`."""

    def print_note(self, sentence: str) -> None:
        """Print a permanent line."""


class DisplayWithWarnings(Display):
    """Prints each warning of a job once, before its view is shown on another display.

    `reword` changes the wording of warnings, because these name options of the command line.
    """

    def __init__(self, display: Display, reword: Callable[[str], str] = str) -> None:
        self._display = display
        self._reword = reword
        self._warned: set[str] = set()

    def show(self, view: JobView, workforce: Workforce, now: float) -> None:
        """Print the new warnings and show the view."""
        for warning in view.warnings:
            if warning not in self._warned:
                self._warned.add(warning)
                self._display.print_note(self._reword(with_kind(warning, view.notes)))
        self._display.show(view, workforce, now)

    def print_note(self, sentence: str) -> None:
        """Print the sentence on the other display."""
        self._display.print_note(sentence)


class Follower:
    """Follows one job through a client. It calls `check` every `_LOOK_S` seconds, which returns sentences to show, or
    raises.

    `reword` changes the wording of warnings, see `DisplayWithWarnings`.
    """

    def __init__(
        self, client: Client, job: str, display: Display, check: Callable[[], Sequence[str]] = tuple,
        reword: Callable[[str], str] = str,
    ) -> None:  # fmt: skip
        self.job = job
        self.phases: dict[str, float] = defaultdict(float)
        """Duration of each phase of the job in seconds, as observed here."""
        self._client = client
        self._display = DisplayWithWarnings(display, reword)
        self._check = check
        self._view: JobView | None = None
        self._workforce = Workforce()
        self._changed_at = 0.0
        self._seen_at: float | None = None
        self._silent_since: float | None = None

    def follow(self) -> JobView:
        """Return the final state of the job; raises UnreachableError after a silence of `PATIENCE_S` seconds."""
        subscription = Subscription(self._client, self.job)
        while True:
            for sentence in self._check():
                self._display.print_note(sentence)
            self._show_change(subscription)
            if self._view is not None and self._view.state in FINAL_STATES:
                return self._view

    def _show_change(self, subscription: Subscription) -> None:
        """Wait for a change, for at most `_LOOK_S` seconds; show the current state of the job."""
        try:
            change = subscription.wait(_LOOK_S)
        except UnreachableError as error:
            self._tolerate_silence(error)
            return
        self._silent_since = None
        now = self._client.now()
        if change is not None and change.view is not None:
            self._view, self._workforce, self._changed_at = change.view, change.workforce, now
        if self._view is None:
            return
        if self._seen_at is not None:
            self.phases[phase(self._view, self._workforce)] += now - self._seen_at
        self._seen_at = now
        self._display.show(self._with_age(self._view, now), self._workforce, now)

    def _with_age(self, view: JobView, now: float) -> JobView:
        """Return the view with the time since its arrival added; the coordinator sends no message when only time
        passes.
        """
        if view.state in FINAL_STATES or now == self._changed_at:
            return view
        return view.model_copy(update={"elapsed": view.elapsed + now - self._changed_at})

    def _tolerate_silence(self, error: UnreachableError) -> None:
        """Show that the coordinator does not answer; raise UnreachableError after `PATIENCE_S` seconds of silence."""
        now = self._client.now()
        if self._silent_since is None:
            self._silent_since = now
            self._display.print_note(f"the coordinator does not answer; waiting another {PATIENCE_S:.0f} s for it")
        elif now - self._silent_since > PATIENCE_S:
            raise UnreachableError(f"{error}; the job may continue there: coordinator status {self.job}") from error


def phase(view: JobView, workforce: Workforce) -> str:
    """Return the current phase: starting, compiling or loading kernels, preparing, searching, refining."""
    if view.state == "refining":
        return "refining"
    if any(variable.epoch for variable in view.variables):
        return "searching"
    if workforce.compiling:
        is_compiling = any("compiling" in detail for detail in workforce.details)
        return "compiling kernels" if is_compiling else "loading kernels"
    if view.state == "running":
        return "searching"
    return "preparing" if workforce.alive else "starting"
