"""Sends the events and job views of a coordinator to any number of pages, as server-sent events.

How it works: one subscription per user gets the events of the coordinator. Events have ascending numbers, so a page
that connects again resumes after its last number. While at least one page listens, the views of open jobs are requested
once a second for all pages, and pages get the fields that have changed. Each message is encoded once for all pages. A
page that reads too slowly is disconnected and resumes, so memory stays bounded.

Doubtful: views are polled, because the coordinator sends no event when only counters change. So the numbers on a page
may be a second old, and one client in this process asks once a second even if nothing changes.
"""

import asyncio
import json
import logging
import threading
import time
from collections.abc import AsyncIterator, Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final

from pydantic_core import to_jsonable_python

from atoll.client.client import Client
from atoll.client.follower import Subscription
from atoll.web.gateway import BusyError, Gateway, ThreadClient
from atoll_core.errors import AtollError, UnknownJobError
from atoll_core.wire.messages.limits import MAX_PAGE_JOBS
from atoll_core.wire.messages.views import FINAL_STATES, EventView, JobView

_LOG = logging.getLogger("coordinator.web")

LOOK_S: Final = 1.0
"""Interval of requests for the views of open jobs while a page listens, in seconds."""

KEEP_ALIVE_S: Final = 10.0
"""Interval of comments on a quiet stream, in seconds, so that no proxy closes it."""

MAX_BEHIND: Final = 2_000
"""Maximum number of messages that wait for a slow page; with more, the stream ends, and the page resumes."""

MAX_LISTENERS: Final = 2_000
"""Maximum number of listening pages of all users; one user may have at most half of the remaining number."""

PAGE: Final = 200
"""Number of events per request."""

_WAIT_S: Final = 0.5
_AGAIN_S: Final = 1.0


@dataclass(frozen=True)
class ServerSentEvent:
    """A message of the stream about `job`; `number` is the number of an event, None for other messages."""

    kind: str
    data: str
    job: str | None = None
    number: int | None = None

    @cached_property
    def text(self) -> str:
        """The text of the server-sent event, made once for all pages; JSON has no line breaks."""
        identifier = f"id: {self.number}\n" if self.number is not None else ""
        return f"event: {self.kind}\n{identifier}data: {self.data}\n\n"


@dataclass(eq=False)
class _ListeningPage:
    """A page that listens to `jobs` (None: to all jobs)."""

    jobs: frozenset[str] | None
    queue: asyncio.Queue[ServerSentEvent] = field(default_factory=lambda: asyncio.Queue(MAX_BEHIND))
    is_behind: bool = False

    def put(self, message: ServerSentEvent) -> None:
        if self.jobs is not None and message.kind != "connection" and message.job not in self.jobs:
            return
        try:
            self.queue.put_nowait(message)
        except asyncio.QueueFull:
            self.is_behind = True


class Feed:
    """Serves all pages of one user. Its thread and its task start with the first page."""

    def __init__(self, gateway: Gateway, changed: Callable[[str], object] = lambda job: None) -> None:
        """`changed` is called with the id of each job whose state has changed."""
        self._gateway = gateway
        self._changed = changed
        self._listeners: set[_ListeningPage] = set()
        self._views: dict[str, dict[str, Any]] = {}
        self._touched: set[str] = set()
        self._connection = ServerSentEvent("connection", _encode({"connected": True, "reason": ""}))
        self._last: int | None = None
        self._newest: int | None = None
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._looking: asyncio.Task[None] | None = None

    @property
    def listeners(self) -> int:
        """Number of pages that listen."""
        return len(self._listeners)

    async def listen(self, jobs: Collection[str] | None, after: int | None) -> AsyncIterator[str]:
        """Yield server-sent events of `jobs` (None: of all jobs), after the event number `after` (None: from now on).

        The views of the jobs come first. The stream ends when the page cannot keep up.
        """
        listener = _ListeningPage(None if jobs is None else frozenset(jobs))
        self._listeners.add(listener)
        try:
            self._start()
            yield f"retry: 1000\n\n{self._greeting().text}"
            last = after or 0
            if after is not None:
                async for message in self._missed_events(after, listener):
                    last = message.number or last
                    yield message.text
            if jobs is not None:
                self._touched.update(jobs)
            for view in [*self._views.values()]:
                listener.put(_changes(view["job"], view))
            while not listener.is_behind:
                try:
                    async with asyncio.timeout(KEEP_ALIVE_S):
                        message = await listener.queue.get()
                except TimeoutError:
                    yield ": keep-alive\n\n"
                    continue
                if message.number is None or message.number > last:
                    last = message.number or last
                    yield message.text
        finally:
            self._listeners.discard(listener)

    async def _missed_events(self, after: int, listener: _ListeningPage) -> AsyncIterator[ServerSentEvent]:
        """Yield the stored events after number `after`."""
        while True:
            events = await self._gateway.ask(lambda client, after=after: client.events(None, max(after, 1), PAGE))  # type: ignore[misc]
            for event in events:
                after = event.number
                if listener.jobs is None or event.job in listener.jobs:
                    yield _event_message(event)
            if len(events) < PAGE:
                return

    def stop(self) -> None:
        """End the thread and the task."""
        self._stop.set()
        if self._looking is not None:
            self._looking.cancel()

    # ------------------------------------------------------------------------------------------- events

    def _start(self) -> None:
        if self._thread is None:
            loop = asyncio.get_running_loop()
            self._thread = threading.Thread(target=self._follow, args=(loop,), name="feed", daemon=True)
            self._thread.start()
            self._looking = loop.create_task(self._look_regularly())

    def _follow(self, loop: asyncio.AbstractEventLoop) -> None:
        """Pass on the subscription's events and changes until the process ends; runs in a separate thread."""
        while not self._stop.is_set():
            connection = ThreadClient(self._gateway.destination)
            try:
                connection.ask(lambda client: self._follow_one(client, loop))
            except AtollError as error:
                self._post(loop, self._take_connection, str(error))
                self._stop.wait(_AGAIN_S)
            except Exception:  # the loop continues, so that pages still receive later events
                _LOG.exception("the subscription to the coordinator failed")
                self._stop.wait(_AGAIN_S)
            finally:
                connection.close()

    def _follow_one(self, client: Client, loop: asyncio.AbstractEventLoop) -> None:
        if self._last is None:
            newest = client.events(None, 0, 1)
            self._last = newest[-1].number if newest else 0
            self._post(loop, self._take_number, self._last)
        subscription = Subscription(client, None, self._last)
        self._post(loop, self._take_connection, None)
        while not self._stop.is_set():
            change = subscription.wait(_WAIT_S)
            if change is not None:
                self._last = max(self._last or 0, change.last)
                self._post(loop, self._take_events, change.events)

    @staticmethod
    def _post(loop: asyncio.AbstractEventLoop, take: Any, *values: object) -> None:
        if not loop.is_closed():
            loop.call_soon_threadsafe(take, *values)

    def _greeting(self) -> ServerSentEvent:
        """Return the state of the connection with the newest event number, so that a page without events can resume."""
        return replace(self._connection, number=self._newest)

    def _take_number(self, last: int) -> None:
        self._newest = last
        self._publish(self._greeting())

    def _take_events(self, events: tuple[EventView, ...]) -> None:
        for event in events:
            self._newest = event.number
            if event.job is not None:
                self._touched.add(event.job)
            if event.event == "deleted":  # such an event names no job, because no data of the job are kept
                self._touched |= self._watched_jobs()
            self._publish(_event_message(event))

    def _take_connection(self, reason: str | None) -> None:
        message = ServerSentEvent("connection", _encode({"connected": reason is None, "reason": reason or ""}))
        if message != self._connection:
            self._connection = message
            self._publish(message)

    def _publish(self, message: ServerSentEvent) -> None:
        for listener in self._listeners:
            listener.put(message)

    # ------------------------------------------------------------------------------------------------ views

    async def _look_regularly(self) -> None:
        while True:
            began = time.monotonic()
            if self._listeners:
                try:
                    await self._look()
                except (AtollError, BusyError) as error:
                    self._take_connection(str(error) or "too many requests wait")
                except Exception:
                    _LOG.exception("the request for views of jobs failed")
            await asyncio.sleep(max(0.1, LOOK_S - (time.monotonic() - began)))

    async def _look(self) -> None:
        """Request the views of open jobs, and of jobs with events."""
        touched, self._touched = self._touched, set()
        views = {
            view.job: view
            for view in await self._gateway.ask(lambda client: client.jobs(is_open=True, last=MAX_PAGE_JOBS))
        }
        watched = self._watched_jobs()
        gone = [job for job, view in self._views.items() if view["state"] not in FINAL_STATES and job not in views]
        for job in (touched | {*gone} | (watched - self._views.keys())) - views.keys():
            try:
                views[job] = await self._gateway.ask(lambda client, job=job: client.status(job))  # type: ignore[misc]
            except UnknownJobError:
                if self._views.pop(job, None) is not None:
                    self._publish(ServerSentEvent("job", _encode({"job": job, "changes": {}, "deleted": True}), job))
        self._take_connection(None)
        for view in views.values():
            self._take_view(view)
        ended = [job for job, view in self._views.items() if view["state"] in FINAL_STATES and job not in watched]
        for job in ended:
            del self._views[job]

    def _watched_jobs(self) -> set[str]:
        return {job for listener in self._listeners for job in listener.jobs or ()}

    def _take_view(self, view: JobView) -> None:
        fields = to_jsonable_python(view)
        before = self._views.get(view.job, {})
        changes = {name: value for name, value in fields.items() if before.get(name, _NOTHING) != value}
        if changes.keys() <= _AGEING:  # pages count seconds themselves
            return
        self._views[view.job] = fields
        if "state" in changes:
            self._changed(view.job)
        self._publish(_changes(view.job, changes))


_NOTHING: Final = object()

_AGEING: Final = {"elapsed", "point_evaluations_per_second"}
"""Fields of a view that change only with time."""


def _encode(value: object) -> str:
    return json.dumps(value, separators=(",", ":"))  # without blanks the text is a tenth shorter


def _changes(job: str, changes: Mapping[str, Any]) -> ServerSentEvent:
    return ServerSentEvent("job", _encode({"job": job, "changes": changes}), job)


def _event_message(event: EventView) -> ServerSentEvent:
    return ServerSentEvent("happened", _encode(to_jsonable_python(event)), event.job, event.number)
