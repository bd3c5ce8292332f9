"""Campaigns: a list of keys, each searched and judged, in a journal from which they are gone on with."""

import time
from argparse import Namespace
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeVar

from atoll.terminal.output import note
from atoll_core.config import JobConfig
from atoll_core.data.table import Table
from atoll_core.errors import AtollError
from benchmarks.harness.journal import Ended, Journal
from benchmarks.harness.record import load
from benchmarks.harness.service import Searches, searching
from benchmarks.harness.stopwatch import Stopwatch

Key = TypeVar("Key")
Service = Callable[[], Searches]
"""Returns the service of a campaign, which is started when it is first asked for."""

Answer = Mapping[str, Any] | None


@dataclass(frozen=True)
class Attempt:
    """What came of one job: the contents of its result.json, empty with a `failure`, and its seconds from outside."""

    result: Mapping[str, Any]
    failure: str | None
    seconds: float


def attempt(searches: Searches, name: str, table: Table, config: JobConfig, stopwatch: Stopwatch) -> Attempt:
    """Search one table; raises AtollError where a process of the service has ended."""
    begun = time.monotonic()
    try:
        result = searches.solve(name, table, config, stopwatch.watch)
    except AtollError as error:
        searches.check()  # without a coordinator no job is to blame
        return Attempt({}, str(error), time.monotonic() - begun)
    return Attempt(result, None, time.monotonic() - begun)


def journal_of(name: str, kind: type[Ended], options: Namespace) -> Journal[Ended]:
    """Return the journal that --resume continues; or --out begins, which goes on by itself where it has no --resume."""
    resumed = getattr(options, "resume", None)
    goes_on = not hasattr(options, "resume") and options.out is not None and options.out.exists()
    return Journal(name, kind, resumed or options.out, options.words, resume=resumed is not None or goes_on)


def work_off(
    wanted: Sequence[Key],
    journal: Journal[Ended],
    do: Callable[[Service, Key], tuple[Ended, Answer]],
    line: Callable[[Ended], str],
    workers: int,
) -> list[Ended]:
    """Do what the journal does not have, one after the other; return the outcomes of all that is wanted.

    `do` returns an outcome, and the contents of a result.json if that is to be kept; `line` says how it came out.
    """
    missing = [key for key in wanted if key not in journal.outcomes]
    note(f"{len(wanted)} asked for, {len(wanted) - len(missing)} of them done before")
    with ExitStack() as stack:
        service = cache(lambda: stack.enter_context(searching(workers)))
        for number, key in enumerate(missing, start=1):
            journal.add(*do(service, key))
            note(f"{number} of {len(missing)}: {line(journal.outcomes[key])}; load {load():.1f}")
    return [journal.outcomes[key] for key in wanted]


def judge_again(
    wanted: Sequence[Key], journal: Journal[Ended], judge: Callable[[Key, Ended, Mapping[str, Any]], Ended]
) -> None:
    """Judge the answers that the journal has by the present rules; `judge` is given the old outcome, too."""
    for key in wanted:
        answer = journal.answers.get(key)
        if answer is not None:
            journal.add(judge(key, journal.outcomes[key], answer), answer)
