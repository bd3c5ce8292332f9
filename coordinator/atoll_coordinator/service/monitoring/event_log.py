"""What happens, told twice: as a line of the log at once, and as an event of the job in the store soon after.

Events tell and never decide, so they are written together, a few times a second; a coordinator that is killed loses
the last half second of them and nothing else.
"""

import json
import logging
from collections.abc import Callable
from typing import Any, Final

from atoll.logs import fields
from atoll.wire.messages.views import EventKind, EventView
from atoll_coordinator.service.ports import StorePort
from atoll_coordinator.service.store.events import EventRecord

_LOG = logging.getLogger("coordinator")

_WARNINGS: Final = frozenset({"failed", "stalled", "isolated", "unplaced", "worker-lost", "refused"})
_NAMED: Final = ("variable", "island", "epoch", "term", "worker")

Value = str | int | float | None


class Chronicle:
    """The events of one coordinator."""

    def __init__(self, store: StorePort, clock: Callable[[], str]) -> None:
        """`clock` gives the time of day as ISO text."""
        self._store = store
        self._clock = clock
        self._pending: list[EventRecord] = []

    def note(self, kind: EventKind, text: str, job: str | None = None, **values: Value) -> None:
        """Tell what happened, in a sentence, and in fields: `variable`, `island`, `epoch`, `term`, `worker`, others."""
        said = {name: value for name, value in values.items() if value is not None}
        level = logging.WARNING if kind in _WARNINGS else logging.INFO
        _LOG.log(level, kind, extra=fields(job=job, **said, text=text))
        self._pending.append(EventRecord(job, self._clock(), kind, json.dumps({"text": text, **said})))

    def flush(self) -> None:
        """Write what is not in the store yet."""
        if self._pending:
            pending, self._pending = self._pending, []
            self._store.add_events(pending)

    def read(self, job: str | None, after: int, limit: int) -> tuple[EventView, ...]:
        """Return what happened to a job, or at all, after an event; see `Store.events`."""
        self.flush()
        return tuple(view_of(record) for record in self._store.events(job, after, limit))


def view_of(record: EventRecord) -> EventView:
    """Return a stored event as people are shown it."""
    contents: dict[str, Any] = json.loads(record.contents)
    named = {name: contents.pop(name, None) for name in _NAMED}
    return EventView.model_validate(
        {
            "number": record.number, "time": record.time, "event": record.kind, "text": contents.pop("text", ""),
            "job": record.job, **named, "details": contents,
        }
    )  # fmt: skip
