"""The verbs that change what waits and who computes: jobs of one's own, and for admins workers and the queue."""

import argparse

from pydantic_core import to_jsonable_python

from atoll.cli.exit_codes import DONE
from atoll.cli.options.values import job_id
from atoll.cli.request import CONNECT_LIMIT_S, address_of
from atoll.client.client import Client, connected
from atoll.terminal.output import as_json, say
from atoll_core.errors import UsageError
from atoll_core.wire.messages.views import CoordinatorView, JobView, WorkerService


def pause(options: argparse.Namespace) -> int:
    """Have a job stop at a checkpoint and wait until it is resumed."""
    with connected(address_of(options), CONNECT_LIMIT_S) as client:
        view = client.pause_job(client.resolve(options.job))
    return _tell(options, view, f"job {view.job} is paused; go on with: coordinator resume {view.job}")


def resume(options: argparse.Namespace) -> int:
    """Let a job go on that was paused."""
    with connected(address_of(options), CONNECT_LIMIT_S) as client:
        view = client.pause_job(client.resolve(options.job), paused=False)
    return _tell(options, view, f"job {view.job} goes on" + (f": it {view.reason}" if view.reason else ""))


def priority(options: argparse.Namespace) -> int:
    """Give a job another priority."""
    with connected(address_of(options), CONNECT_LIMIT_S) as client:
        view = client.set_priority(client.resolve(options.job), options.priority)
    return _tell(options, view, f"job {view.job} has priority {view.priority}")


def share(options: argparse.Namespace) -> int:
    """Let everybody see a job, or only its submitter and admins."""
    with connected(address_of(options), CONNECT_LIMIT_S) as client:
        view = client.share(client.resolve(options.job), shared=not options.private)
    return _tell(options, view, f"job {view.job} is {'shared with everybody' if view.shared else 'private'}")


def retry(options: argparse.Namespace) -> int:
    """Submit what a job was submitted with once more, and print the new job's id."""
    again = job_id(options.id)
    with connected(address_of(options), CONNECT_LIMIT_S) as client:
        view = client.retry(client.resolve(options.job), again)
    return _tell(options, view, view.job)


def cordon(options: argparse.Namespace) -> int:
    """Give a worker no more islands."""
    return _set_worker(options, "cordoned", "keeps the islands that it has, and gets no more")


def uncordon(options: argparse.Namespace) -> int:
    """Let a worker have islands again."""
    return _set_worker(options, "open", "gets islands again")


def drain(options: argparse.Namespace) -> int:
    """Have a worker hand over the islands that it has, and give it no more."""
    return _set_worker(options, "draining", "hands over its islands, and gets no more")


def queue(options: argparse.Namespace) -> int:
    """Show the queue, or have no more jobs taken up, or go on."""
    with connected(address_of(options), CONNECT_LIMIT_S) as client:
        view = client.pause_queue(paused=options.change == "pause") if options.change else client.coordinator()
    say(as_json(to_jsonable_python(view)) if options.json else _queue_line(view))
    return DONE


def _queue_line(view: CoordinatorView | None) -> str:
    if view is None:
        return "the coordinator says nothing of its queue"
    manner = "is paused; jobs are taken up again after: coordinator queue resume" if view.paused else "is open"
    jobs = "1 job is" if view.under_way == 1 else f"{view.under_way} jobs are"
    return f"the queue {manner}; {jobs} under way, {view.queued} {'waits' if view.queued == 1 else 'wait'}"


def _set_worker(options: argparse.Namespace, service: WorkerService, sentence: str) -> int:
    with connected(address_of(options), CONNECT_LIMIT_S) as client:
        worker = _worker(client, options.job)
        views = client.set_worker(worker, service)
    if options.json:
        say(as_json(to_jsonable_python([view for view in views if view.worker == worker])))
    else:
        say(f"worker {worker} {sentence}")
    return DONE


def _worker(client: Client, prefix: str) -> str:
    """Return the name of the one worker that is meant; one that is not here is left to the coordinator."""
    names = [view.worker for view in client.workers()]
    if prefix in names:
        return prefix
    meant = [name for name in names if name.startswith(prefix)]
    if len(meant) > 1:
        raise UsageError(f"which worker is meant? {len(meant)} begin with {prefix!r}: {', '.join(meant[:20])}")
    return meant[0] if meant else prefix


def _tell(options: argparse.Namespace, view: JobView, sentence: str) -> int:
    say(as_json(to_jsonable_python(view)) if options.json else sentence)
    return DONE
