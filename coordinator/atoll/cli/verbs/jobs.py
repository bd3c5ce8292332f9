"""The verbs about the jobs of a coordinator: to list and show them, to cancel or delete one."""

import argparse
from collections.abc import Sequence
from typing import Final

from pydantic_core import to_jsonable_python

from atoll.cli.exit_codes import DONE, end_of_cancelled, finish
from atoll.cli.request import CONNECT_LIMIT_S, address_of
from atoll.client.client import Client, connected
from atoll.client.follower import Display, Follower
from atoll.client.over_http import Whereabouts
from atoll.terminal.output import as_json, clipped, count, duration, say, table
from atoll.terminal.progress import JsonDisplay, LiveDisplay, PlainDisplay, is_screen, plain_lines
from atoll_core.data.notes import with_kind
from atoll_core.errors import UsageError
from atoll_core.signals import raising_interrupts
from atoll_core.wire.messages.views import FINAL_STATES, JobView, Workforce

_SHOWN: Final = 20
"""Jobs under way that are named when one is to be chosen."""


def jobs(options: argparse.Namespace) -> int:
    """List all jobs, or those whose id begins with ``options.job``, or the ``options.last`` of them."""
    with connected(address_of(options), CONNECT_LIMIT_S) as client:
        views = client.jobs(options.job or "", last=options.last)
    say(_json(views) if options.json else _job_table(views))
    return DONE


def status(options: argparse.Namespace) -> int:
    """Show one job, or all that have not ended; with ``--follow`` one, until it ends, with its exit code."""
    address = address_of(options)
    if options.follow:
        return _follow_job(options, address)
    with connected(address, CONNECT_LIMIT_S) as client:
        views = client.jobs(is_open=True) if options.job is None else [client.status(client.resolve(options.job))]
        workforce = Workforce.of(client.workers())
    if options.json:
        say(_json(views if options.job is None else views[0]))
    else:
        hint = f"island-worker --connect {address}"
        say("\n\n".join(_status_text(view, workforce, hint) for view in views) or "no job is under way")
    return DONE


def _follow_job(options: argparse.Namespace, address: Whereabouts) -> int:
    """Show a job, the only one under way unless it is named, whenever it changes; return its exit code."""
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
    return finish(view)


def cancel(options: argparse.Namespace) -> int:
    """End a job, the only one under way unless it is named; its best equations stay."""
    with connected(address_of(options), CONNECT_LIMIT_S) as client:
        job = _chosen_job(client, options.job)
        had_ended = client.status(job).state in FINAL_STATES
        view = client.cancel_and_wait(job)
    if options.json:
        say(_json(view))
    elif had_ended:
        say(f"job {job} had ended already: {view.state}")
    elif view.state not in FINAL_STATES:
        say(f"job {job} is being cancelled; its result is still composed: coordinator status {job}")
    else:
        say(f"job {job} is cancelled{end_of_cancelled(view, f'; its best equations: coordinator result {job}')}")
    return DONE


def delete(options: argparse.Namespace) -> int:
    """Delete a job that has ended."""
    with connected(address_of(options), CONNECT_LIMIT_S) as client:
        job = client.resolve(options.job)
        client.delete(job)
    say(as_json({"deleted": job}) if options.json else f"job {job} is deleted")
    return DONE


def _chosen_job(client: Client, prefix: str | None) -> str:
    """Return the id of the job that is named, or of the only one under way."""
    if prefix is not None:
        return client.resolve(prefix)
    views = client.jobs(is_open=True, last=_SHOWN + 1)
    if len(views) != 1:
        there = ", ".join(view.job for view in views[-_SHOWN:]) or "none"
        there += " and others" if len(views) > _SHOWN else ""
        raise UsageError(f"which job is meant? name one of those under way: {there}")
    return views[0].job


def _json(views: object) -> str:
    return as_json(to_jsonable_python(views))


def _status_text(view: JobView, workforce: Workforce, hint: str) -> str:
    notes = [f"  stands still: {stall}" for stall in view.stalls]
    notes += [f"  {with_kind(warning, view.notes)}" for warning in view.warnings]
    return "\n".join([*plain_lines(view, workforce, hint), *notes])


def _job_table(views: Sequence[JobView]) -> str:
    if not views:
        return "no job is here; give one with: coordinator submit DATA"
    heads = ("ID", "NAME", "STATE", "PRIORITY", "TIME", "WORKERS", "EPOCHS", "POINT-EVALS", "FOUND", "NOTE")
    return table(heads, [_row(view) for view in views])


def _row(view: JobView) -> tuple[str, ...]:
    epochs = ",".join(str(variable.epoch) for variable in view.variables) or "-"
    converged = sum(variable.converged for variable in view.variables)
    return (
        view.job, clipped(view.name, 24), view.state, str(view.priority), duration(view.elapsed), str(view.workers),
        epochs, count(view.point_evaluations), f"{converged} of {len(view.variables)}",
        clipped(view.reason or (view.stalls[0] if view.stalls else ""), 70),
    )  # fmt: skip
