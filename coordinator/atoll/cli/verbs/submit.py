"""``coordinator submit``: give a job to a coordinator and follow it; leaving early leaves the job running."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from atoll.cli.exit_codes import DONE, INTERRUPTED, finish
from atoll.cli.request import CONNECT_LIMIT_S, Request, address_of, request_of
from atoll.cli.result_files import REPORT, refuse_existing_result, write_report, write_result
from atoll.client.client import Client, connected
from atoll.client.follower import Follower
from atoll.terminal.output import note, say
from atoll.terminal.progress import open_display, waiting
from atoll_core.errors import UsageError
from atoll_core.signals import raising_interrupts
from atoll_core.wire.messages.views import FINAL_STATES, JobView, Workforce

if TYPE_CHECKING:
    from atoll_coordinator.result.result import Result


def submit(options: argparse.Namespace) -> int:
    """Submit ``options.data`` as a job; return the exit code of the job unless told not to wait for it."""
    request = request_of(options)
    if options.dry_run:
        return request.rehearse()
    address = address_of(options)
    folder = Path(options.out) if options.out is not None else None
    if folder is not None and options.no_wait:
        raise UsageError("--out and --no-wait contradict each other: there is no result yet; fetch it later")
    if options.report and (folder is None or options.no_wait):
        raise UsageError("--report writes a page beside the result, so it needs --out and the wait for the result")
    if folder is not None:
        refuse_existing_result(folder)
    with raising_interrupts(), connected(address, CONNECT_LIMIT_S) as client:
        look = f"coordinator status {request.job} --connect {address}"
        hint = f"island-worker --connect {address}"
        try:
            view = request.submit(client, request.read())
        except KeyboardInterrupt:
            note(f"interrupted before job {request.job} was known to be taken in: {look}")
            return INTERRUPTED
        if options.no_wait:
            _say_what_it_waits_for(view, client, hint)
            say(request.job)
            return DONE
        try:
            with open_display(hint) as display:
                display.print_note(f"job {request.job} submitted; Ctrl-C detaches and leaves it running")
                view = Follower(client, request.job, display).follow()
        except KeyboardInterrupt:
            note(f"detached; the job goes on: {look}")
            return INTERRUPTED
        result = request.result(client, view)
        if result is not None:
            _deliver(request, result, folder, has_report=options.report)
        return finish(view)


def _say_what_it_waits_for(view: JobView, client: Client, hint: str) -> None:
    """Tell somebody who leaves now what keeps the job from being searched at once, if anything does."""
    if view.state in FINAL_STATES:
        note(f"job {view.job} is known, and has ended: {view.state}")
    elif waits := waiting(view, Workforce.of(client.workers()), hint):
        note(f"job {view.job} {view.state}; {waits}")


def _deliver(request: Request, result: "Result", folder: Path | None, *, has_report: bool) -> None:
    """Print a result, and write it and its page into a folder if one was named."""
    if folder is not None:
        note(f"result in {write_result(folder, result)}")
    request.show(result)
    if folder is not None and has_report:
        write_report(folder / REPORT, result)
