"""The verbs about the jobs and workers of a coordinator.

Verbs that show: ``ping``, ``jobs``, ``status``, ``workers``, ``logs``. Verbs that change a job: ``cancel``, ``delete``,
``pause``, ``resume``, ``priority``, ``share``, ``retry``. Verbs for admins: ``cordon``, ``uncordon``, ``drain``,
``queue``.
"""

import argparse
import json
import time
from collections.abc import Iterable, Sequence
from typing import Final

from pydantic_core import to_jsonable_python

from atoll.cli.exit_codes import DONE, end_of_cancelled, report_exit_code
from atoll.cli.parser import job_id
from atoll.cli.request import CONNECT_LIMIT_S, address_of
from atoll.client.client import Client, connected
from atoll.client.follower import Display, Follower, Subscription
from atoll.client.over_http import Whereabouts
from atoll.terminal.output import as_json, clip, count, duration, say, table
from atoll.terminal.progress import JsonDisplay, LiveDisplay, PlainDisplay, is_screen, plain_lines
from atoll_core.data.notes import with_kind
from atoll_core.errors import UsageError
from atoll_core.signals import raising_interrupts
from atoll_core.wire.messages.views import (
    FINAL_STATES,
    WARNINGS,
    CoordinatorView,
    Counters,
    EventView,
    JobView,
    WorkerService,
    WorkerView,
    Workforce,
)

_MOST_NAMED: Final = 20
"""Maximum number of jobs or workers that a message lists."""

_JOB_HEADS: Final = (
    "ID", "NAME", "STATE", "PRIORITY", "TIME", "WORKERS", "EPOCHS", "POINT-EVALS", "FOUND", "NOTE",
)  # fmt: skip
_WORKER_HEADS: Final = (
    "NAME", "HOST", "PID", "STATE", "ISLANDS", "SILENT", "MEMORY", "CPU", "IN", "OUT", "WAITED", "TROUBLE", "VERSION",
    "CORES", "JOINED", "DOING",
)  # fmt: skip
_TRAFFIC_HEADS: Final = ("KIND", "MESSAGES IN", "BYTES IN", "MESSAGES OUT", "BYTES OUT")
_LEVELS: Final = ("info", "warning", "error")
_WAIT_S: Final = 1.0
"""Longest single wait of `logs --follow` for a change, in seconds, so that Ctrl-C is handled."""


def _print_views(options: argparse.Namespace, views: object, text: str) -> int:
    """Print the views as JSON if ``--json`` is given, else the text; return exit code 0."""
    say(as_json(to_jsonable_python(views)) if options.json else text)
    return DONE


def ping(options: argparse.Namespace) -> int:
    """Greet the coordinator and print the time to its answer; raises UnreachableError after ``options.wait`` seconds.

    The main loop of the coordinator answers, so a coordinator that hangs does not answer.
    """
    address = address_of(options)
    began = time.monotonic()
    with connected(address, options.wait) as client:
        seconds, welcome = time.monotonic() - began, client.welcome
    answer = {"version": welcome.version, "incarnation": welcome.incarnation, "seconds": seconds}
    start = f"start {welcome.incarnation}"
    return _print_views(
        options, answer, f"coordinator {welcome.version} at {address} answers, in {1000 * seconds:.0f} ms ({start})"
    )


# ------------------------------------------------------------------------------------- jobs and status


def jobs(options: argparse.Namespace) -> int:
    """List all jobs, or the jobs whose id begins with ``options.job``; at most the newest ``options.last`` jobs."""
    with connected(address_of(options), CONNECT_LIMIT_S) as client:
        views = client.jobs(options.job or "", last=options.last)
    text = "no jobs; submit one with: coordinator submit DATA"
    return _print_views(options, views, table(_JOB_HEADS, [_job_row(view) for view in views]) if views else text)


def _job_row(view: JobView) -> tuple[str, ...]:
    epochs = ",".join(str(variable.epoch) for variable in view.variables) or "-"
    converged = sum(variable.converged for variable in view.variables)
    return (
        view.job, clip(view.name, 24), view.state, str(view.priority), duration(view.elapsed), str(view.workers),
        epochs, count(view.point_evaluations), f"{converged} of {len(view.variables)}",
        clip(view.reason or (view.stalls[0] if view.stalls else ""), 70),
    )  # fmt: skip


def status(options: argparse.Namespace) -> int:
    """Show one job, or all jobs that have not ended; ``--follow``: show a job until its end, return its exit code."""
    address = address_of(options)
    if options.follow:
        return _follow_job(options, address)
    with connected(address, CONNECT_LIMIT_S) as client:
        views = client.jobs(is_open=True) if options.job is None else [client.status(client.resolve(options.job))]
        workforce = Workforce.of(client.workers())
    texts = []
    for view in views:
        notes = [f"  no progress: {stall}" for stall in view.stalls]
        notes += [f"  {with_kind(warning, view.notes)}" for warning in view.warnings]
        texts.append("\n".join([*plain_lines(view, workforce, f"island-worker --connect {address}"), *notes]))
    return _print_views(
        options, views if options.job is None else views[0], "\n\n".join(texts) or "all jobs have ended"
    )


def _follow_job(options: argparse.Namespace, address: Whereabouts) -> int:
    with raising_interrupts(), connected(address, CONNECT_LIMIT_S) as client:
        job = _chosen_job(client, options.job)
        hint = f"island-worker --connect {address}"
        display: Display = PlainDisplay(hint, say)
        if options.json:
            display = JsonDisplay(say)
        elif is_screen():
            display = LiveDisplay(hint)
        with display:
            view = Follower(client, job, display).follow()
    return report_exit_code(view)


def cancel(options: argparse.Namespace) -> int:
    """Cancel a job (default: the only job that has not ended); its best equations are kept."""
    with connected(address_of(options), CONNECT_LIMIT_S) as client:
        job = _chosen_job(client, options.job)
        had_ended = client.status(job).state in FINAL_STATES
        view = client.cancel_and_wait(job)
    if had_ended:
        text = f"job {job} had already ended: {view.state}"
    elif view.state not in FINAL_STATES:
        text = f"job {job} is being cancelled; its result is not complete yet: coordinator status {job}"
    else:
        text = f"job {job} is cancelled{end_of_cancelled(view, f'; its best equations: coordinator result {job}')}"
    return _print_views(options, view, text)


def delete(options: argparse.Namespace) -> int:
    """Delete a job that has ended."""
    with connected(address_of(options), CONNECT_LIMIT_S) as client:
        job = client.resolve(options.job)
        client.delete(job)
    return _print_views(options, {"deleted": job}, f"job {job} is deleted")


def _chosen_job(client: Client, prefix: str | None) -> str:
    """Return the id of the job whose id begins with `prefix`; if `prefix` is None, the id of the only job that has not
    ended."""
    if prefix is not None:
        return client.resolve(prefix)
    views = client.jobs(is_open=True, last=_MOST_NAMED + 1)
    if len(views) != 1:
        names = ", ".join(view.job for view in views[-_MOST_NAMED:])
        names += " and others" if len(views) > _MOST_NAMED else ""
        found = f"several jobs have not ended: {names}" if names else "no job is waiting or running"
        raise UsageError(f"no job was named, and {found}; name one")
    return views[0].job


def pause(options: argparse.Namespace) -> int:
    """Stop a job at a checkpoint until it is resumed."""
    with connected(address_of(options), CONNECT_LIMIT_S) as client:
        view = client.pause_job(client.resolve(options.job))
    return _print_views(options, view, f"job {view.job} is paused; continue it with: coordinator resume {view.job}")


def resume(options: argparse.Namespace) -> int:
    """Continue a job that was paused."""
    with connected(address_of(options), CONNECT_LIMIT_S) as client:
        view = client.pause_job(client.resolve(options.job), paused=False)
    return _print_views(options, view, f"job {view.job} continues" + (f": it {view.reason}" if view.reason else ""))


def priority(options: argparse.Namespace) -> int:
    """Change the priority of a job."""
    with connected(address_of(options), CONNECT_LIMIT_S) as client:
        view = client.set_priority(client.resolve(options.job), options.priority)
    return _print_views(options, view, f"job {view.job} has priority {view.priority}")


def share(options: argparse.Namespace) -> int:
    """Make a job visible to all users, or only to its submitter and admins."""
    with connected(address_of(options), CONNECT_LIMIT_S) as client:
        view = client.share(client.resolve(options.job), shared=not options.private)
    return _print_views(options, view, f"job {view.job} is {'visible to all users' if view.shared else 'private'}")


def retry(options: argparse.Namespace) -> int:
    """Submit a job again, as a new job, and print the new id."""
    new_id = job_id(options.id)
    with connected(address_of(options), CONNECT_LIMIT_S) as client:
        view = client.retry(client.resolve(options.job), new_id)
    return _print_views(options, view, view.job)


# ------------------------------------------------------------------------------------------------ logs


def logs(options: argparse.Namespace) -> int:
    """Print the last events of a job or of all jobs; with ``--follow`` also new events, until the job ends."""
    with raising_interrupts(), connected(address_of(options), CONNECT_LIMIT_S) as client:
        job = client.resolve(options.job) if options.job is not None else None
        events = _wanted(client.events(job, 0, options.lines, of_workers=options.workers), options)
        if not options.follow:
            nothing = f"no events of job {job}" if job is not None else "no events yet"
            return _print_views(options, events, "\n".join(line(event) for event in events) or nothing)
        _print(events, options.json)
        subscription = Subscription(client, job, events[-1].number if events else 0)
        while True:
            change = subscription.wait(_WAIT_S)
            if change is None:
                continue
            _print(_wanted(change.events, options), options.json)
            if change.view is not None and change.view.state in FINAL_STATES and not change.has_more:
                return DONE


def _wanted(events: Iterable[EventView], options: argparse.Namespace) -> list[EventView]:
    """Return the events that the options select; the kind of a coordinator's event determines its level."""
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


def _print(events: Iterable[EventView], as_objects: bool) -> None:
    for event in events:
        say(json.dumps(to_jsonable_python(event), ensure_ascii=False) if as_objects else line(event))


def line(event: EventView) -> str:
    """Return an event on one line: time, kind, text, and its job, island or worker."""
    place = [
        ("job", event.job), ("variable", event.variable), ("term", event.term), ("epoch", event.epoch),
        ("island", event.island), ("worker", event.worker),
    ]  # fmt: skip
    where = " ".join(f"{name}={value}" for name, value in place if value is not None)
    when = event.time.replace("T", " ")[:23]
    return f"{when}  {event.event:13}  {event.text}" + (f"  [{where}]" if where else "")


# --------------------------------------------------------------------------------------------- workers


def workers(options: argparse.Namespace) -> int:
    """List all workers, or the workers with names that begin with ``options.job``; or show the coordinator's
    counters."""
    address = address_of(options)
    with connected(address, CONNECT_LIMIT_S) as client:
        views = client.workers(options.job or "")
        own = client.coordinator() if options.coordinator else None
    if options.coordinator:
        return _print_views(options, own, coordinator_lines(own))
    text = f"no workers; start one with: island-worker --connect {address}"
    return _print_views(options, views, worker_table(views) if views else text)


def worker_table(views: Sequence[WorkerView]) -> str:
    """Return a table with one line for each worker."""
    return table(_WORKER_HEADS, [_worker_row(view) for view in views])


def _worker_row(view: WorkerView) -> tuple[str, ...]:
    counters = view.counters
    doing = f"{view.doing}, {view.standing:.0f} s without progress" if view.standing >= 5.0 else view.doing
    return (
        view.worker, view.host, str(view.pid),
        view.state if view.service == "open" else f"{view.state}, {view.service}",
        str(view.islands), f"{view.silent:.1f} s", size(counters.memory_bytes), duration(counters.cpu_s),
        size(sum(entry.bytes_in for entry in counters.traffic)),
        size(sum(entry.bytes_out for entry in counters.traffic)),
        duration(counters.waited_s), trouble(counters), view.version, str(view.cores),
        duration(view.joined), doing or view.detail,
    )  # fmt: skip


def coordinator_lines(view: CoordinatorView | None) -> str:
    """Return the coordinator's state, and its traffic by kind of message."""
    if view is None:
        return "the coordinator reports no state of its own"
    counters, store = view.counters, view.store
    mean = store.total_s / store.transactions if store.transactions else 0.0
    lines = [
        f"coordinator {view.version}, start {view.incarnation}, running for {duration(view.seconds)}",
        f"memory {size(counters.memory_bytes)}, CPU {duration(counters.cpu_s)}, "
        f"{counters.refused} messages refused, {counters.dropped} dropped, {counters.broken} events failed",
        f"store: {store.transactions} transactions, {1000 * mean:.1f} ms each, {1000 * store.worst_s:.1f} ms at most",
    ]
    rows = [
        (entry.kind, str(entry.messages_in), size(entry.bytes_in), str(entry.messages_out), size(entry.bytes_out))
        for entry in counters.traffic
    ]
    return "\n".join([*lines, table(_TRAFFIC_HEADS, rows)])


def size(number_of_bytes: int) -> str:
    """Return a number of bytes with a unit and three significant digits."""
    number = float(number_of_bytes)
    for unit in ("B", "kB", "MB"):
        if number < 999.5:
            return f"{number:.3g} {unit}"
        number /= 1000.0
    return f"{number:.3g} GB"


def trouble(counters: Counters) -> str:
    """Return the numbers of refused, dropped and duplicate messages; ``-`` if all are 0."""
    counts = (("refused", counters.refused), ("dropped", counters.dropped), ("twice", counters.duplicates))
    return ", ".join(f"{number} {name}" for name, number in counts if number) or "-"


_SERVICES: Final[dict[str, tuple[WorkerService, str]]] = {
    "cordon": ("cordoned", "keeps its islands, and gets no more"),
    "uncordon": ("open", "gets islands again"),
    "drain": ("draining", "hands over its islands, and gets no more"),
}


def serve_islands(options: argparse.Namespace) -> int:
    """Change whether a worker gets new islands and whether it keeps its present islands: see `_SERVICES`."""
    service, sentence = _SERVICES[options.verb]
    with connected(address_of(options), CONNECT_LIMIT_S) as client:
        name = options.job
        names = [view.worker for view in client.workers()]
        matches = [name] if name in names else [each for each in names if each.startswith(name)]
        if len(matches) > 1:
            shown = ", ".join(matches[:_MOST_NAMED])
            raise UsageError(f"{len(matches)} workers have names that begin with {name!r}: {shown}; name one")
        worker = matches[0] if matches else name  # the coordinator refuses unknown workers
        views = client.set_worker(worker, service)
    return _print_views(options, [view for view in views if view.worker == worker], f"worker {worker} {sentence}")


cordon = uncordon = drain = serve_islands


def queue(options: argparse.Namespace) -> int:
    """Show the queue, or pause or resume it."""
    with connected(address_of(options), CONNECT_LIMIT_S) as client:
        view = client.pause_queue(paused=options.change == "pause") if options.change else client.coordinator()
    if view is None:
        return _print_views(options, view, "the coordinator reports no state of its queue")
    state = "is paused; continue it with: coordinator queue resume" if view.paused else "is open"
    running = "1 job is" if view.under_way == 1 else f"{view.under_way} jobs are"
    waiting = f"{view.queued} {'waits' if view.queued == 1 else 'wait'}"
    return _print_views(options, view, f"the queue {state}; {running} under way, {waiting}")
