"""The verbs that look at, cancel or delete jobs: ``jobs``, ``status``, ``workers``, ``cancel``, ``delete``."""

import argparse
from collections.abc import Sequence
from typing import Final

from atoll.cli.exit_codes import DONE, NOTHING_FOUND, finish, has_found
from atoll.cli.request import CONNECT_LIMIT_S, address_of
from atoll.cli.worker_table import coordinator_lines, worker_table
from atoll.client.client import Client, connected
from atoll.client.follower import Follower
from atoll.terminal.output import as_json, clipped, count, duration, say, table
from atoll.terminal.progress import JsonDisplay, LiveDisplay, PlainDisplay, is_screen, plain_lines
from atoll_core.config import Frozen
from atoll_core.errors import UsageError
from atoll_core.signals import raising_interrupts
from atoll_core.wire.addresses import Destination
from atoll_core.wire.messages.views import FINAL_STATES, JobView, WorkerView

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
        return _follow(options, address)
    with connected(address, CONNECT_LIMIT_S) as client:
        views = client.jobs(is_open=True) if options.job is None else [client.status(client.resolve(options.job))]
        workers = client.workers()
    if options.json:
        say(_json(views) if options.job is None else as_json(views[0].model_dump(mode="json")))
    else:
        hint = f"island-worker --connect {address}"
        say("\n\n".join(_status_text(view, workers, hint) for view in views) or "no job is under way")
    return DONE


def _follow(options: argparse.Namespace, address: Destination) -> int:
    """Show a job, the only one under way unless it is named, whenever it changes; return its exit code."""
    with raising_interrupts(), connected(address, CONNECT_LIMIT_S) as client:
        job = _only_open_job(client) if options.job is None else client.resolve(options.job)
        hint = f"island-worker --connect {address}"
        lines = LiveDisplay(hint) if is_screen() else PlainDisplay(hint, say)
        with JsonDisplay(say) if options.json else lines as display:
            view = Follower(client, job, display).follow()
    return finish(view)


def workers(options: argparse.Namespace) -> int:
    """List all workers, or those whose name begins with ``options.job``; or show the coordinator's own counters."""
    address = address_of(options)
    with connected(address, CONNECT_LIMIT_S) as client:
        views = [view for view in client.workers() if view.worker.startswith(options.job or "")]
        own = client.coordinator() if options.coordinator else None
    if options.coordinator:
        say(as_json(own.model_dump(mode="json") if own else None) if options.json else coordinator_lines(own))
    elif options.json:
        say(_json(views))
    else:
        say(worker_table(views) if views else f"no worker is here; start one with: island-worker --connect {address}")
    return DONE


def cancel(options: argparse.Namespace) -> int:
    """End a job, the only one under way unless it is named; its best equations stay."""
    with connected(address_of(options), CONNECT_LIMIT_S) as client:
        job = _only_open_job(client) if options.job is None else client.resolve(options.job)
        had_ended = client.status(job).state in FINAL_STATES
        view = client.cancel(job)
    if options.json:
        say(as_json(view.model_dump(mode="json")))
    elif had_ended:
        say(f"job {job} had ended already: {view.state}")
    else:
        outcome = f"; its best equations: coordinator result {job}" if has_found(view) else NOTHING_FOUND
        say(f"job {job} is cancelled{outcome}")
    return DONE


def delete(options: argparse.Namespace) -> int:
    """Delete a job that has ended."""
    with connected(address_of(options), CONNECT_LIMIT_S) as client:
        job = client.resolve(options.job)
        client.delete(job)
    say(as_json({"deleted": job}) if options.json else f"job {job} is deleted")
    return DONE


def _only_open_job(client: Client) -> str:
    views = client.jobs(is_open=True, last=_SHOWN + 1)
    if len(views) != 1:
        there = ", ".join(view.job for view in views[-_SHOWN:]) or "none"
        there += " and others" if len(views) > _SHOWN else ""
        raise UsageError(f"which job is meant? name one of those under way: {there}")
    return views[0].job


def _json(views: Sequence[Frozen]) -> str:
    return as_json([view.model_dump(mode="json") for view in views])


def _status_text(view: JobView, workers: Sequence[WorkerView], hint: str) -> str:
    notes = [f"  stands still: {stall}" for stall in view.stalls]
    notes += [f"  note: {warning}" for warning in view.warnings]
    return "\n".join([*plain_lines(view, workers, hint), *notes])


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
