"""The verb that shows events, once or as they come."""

import argparse
import json
from collections.abc import Iterable
from typing import Final

from pydantic_core import to_jsonable_python

from atoll.cli.exit_codes import DONE
from atoll.cli.request import CONNECT_LIMIT_S, address_of
from atoll.client.client import Client, connected
from atoll.client.subscription import Subscription
from atoll.terminal.output import as_json, say
from atoll_core.signals import raising_interrupts
from atoll_core.wire.messages.views import FINAL_STATES, WARNINGS, EventView

_LEVELS: Final = ("info", "warning", "error")
_LOOK_S: Final = 1.0
"""How long a change is waited for at a time."""


def logs(options: argparse.Namespace) -> int:
    """Show the last events of a job, or of everything; with ``--follow`` also those to come, until the job ends."""
    with raising_interrupts(), connected(address_of(options), CONNECT_LIMIT_S) as client:
        job = client.resolve(options.job) if options.job is not None else None
        events = _wanted(client.events(job, 0, options.lines, of_workers=options.workers), options)
        if not options.follow:
            nothing = f"nothing is noted of job {job}" if job is not None else "nothing is noted yet"
            text = "\n".join(line(event) for event in events) or nothing
            say(as_json(to_jsonable_python(events)) if options.json else text)
            return DONE
        _show(events, options.json)
        return _follow_events(client, job, events[-1].number if events else 0, options)


def _wanted(events: Iterable[EventView], options: argparse.Namespace) -> list[EventView]:
    """Return the events that the options ask for; what the coordinator itself tells has the level of its kind."""
    least = _LEVELS.index(options.level)
    return [
        event
        for event in events
        if (event.event == "log" or not options.workers) and _LEVELS.index(_level(event)) >= least
    ]


def _level(event: EventView) -> str:
    if event.event == "log":
        level = str(event.details.get("level", "info"))
        return level if level in _LEVELS else "info"
    return "error" if event.event in ("failed", "broken") else "warning" if event.event in WARNINGS else "info"


def _follow_events(client: Client, job: str | None, last: int, options: argparse.Namespace) -> int:
    """Show what comes, until the job has ended and all of it has been shown."""
    subscription = Subscription(client, job, last)
    while True:
        change = subscription.wait(_LOOK_S)
        if change is None:
            continue
        _show(_wanted(change.events, options), options.json)
        if change.view is not None and change.view.state in FINAL_STATES and not change.has_more:
            return DONE


def _show(events: Iterable[EventView], as_objects: bool) -> None:
    """Print events one by one; as JSON, one object a line."""
    for event in events:
        say(json.dumps(to_jsonable_python(event), ensure_ascii=False) if as_objects else line(event))


def line(event: EventView) -> str:
    """Return an event on one line: when, what, whose, in words, where."""
    place = [
        ("job", event.job), ("variable", event.variable), ("term", event.term), ("epoch", event.epoch),
        ("island", event.island), ("worker", event.worker),
    ]  # fmt: skip
    where = " ".join(f"{name}={value}" for name, value in place if value is not None)
    when = event.time.replace("T", " ")[:23]
    return f"{when}  {event.event:13}  {event.text}" + (f"  [{where}]" if where else "")
