"""Many jobs of the corpus, one after the other on warm processes, kept in a file from which they can be resumed."""

import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from typing import Any

import numpy as np

from atoll.config import PRESETS, JobConfig
from atoll.errors import AtollError
from atoll_coordinator.cli.terminal.output import note
from benchmarks.corpus.cases import OURS, Case, Key, make_case
from benchmarks.corpus.outcomes import Outcome, judge_job
from benchmarks.harness.journal import Journal
from benchmarks.harness.record import load
from benchmarks.harness.service import Searches, searching
from benchmarks.harness.stopwatch import Stopwatch
from benchmarks.noise import data as noise
from benchmarks.peers import operon_models, pysindy_models


def run_jobs(
    keys: Sequence[Key], journal: Journal[Outcome], workers: int, max_time: float | None, changes: Mapping[str, Any]
) -> list[Outcome]:
    """Do the jobs that the journal does not have; return the outcomes of all. `changes` are of the configuration."""
    missing = [key for key in keys if key not in journal.outcomes]
    note(f"{len(keys)} jobs, {len(keys) - len(missing)} of them done before")
    with ExitStack() as stack:
        searches = None
        if any(key.method == OURS for key in missing):
            searches = stack.enter_context(searching(workers))
        for number, key in enumerate(missing, start=1):
            if key.method != OURS:
                _solve_otherwise(key, journal)
            elif searches is not None:
                _run(searches, key, journal, max_time, changes)
            note(f"{number} of {len(missing)}: {line(journal.outcomes[key])}; load {load():.1f}")
    return [journal.outcomes[key] for key in keys]


def judge_again(keys: Sequence[Key], journal: Journal[Outcome]) -> None:
    """Judge what the journal has of `keys` by the present rules; what the jobs took stays."""
    for key in keys:
        answer = journal.answers.get(key)
        if answer is not None:
            old = journal.outcomes[key]
            stopwatch = Stopwatch(seconds=dict(old.wall), processor=dict(old.cpu))
            case = make_case(key)
            journal.add(judge_job(key, case, answer, stopwatch, config=configuration(key, case, None, {})), answer)


def configuration(key: Key, case: Case, max_time: float | None, changes: Mapping[str, Any]) -> JobConfig:
    """Return the default configuration with the functions that the truth needs."""
    config = PRESETS["default"]
    operators = (*config.space.operators, *case.system.operators)
    return config.model_copy(
        update={
            "seed": key.seed,
            "data": config.data.model_copy(update=dict(case.data)),
            "space": config.space.model_copy(update={"operators": operators}),
            "budget": config.budget.model_copy(update={"max_time": max_time, **changes}),
        }
    )


def _run(
    searches: Searches, key: Key, journal: Journal[Outcome], max_time: float | None, changes: Mapping[str, Any]
) -> None:
    case, stopwatch, begun = make_case(key), Stopwatch(counts=True), time.monotonic()
    config = configuration(key, case, max_time, changes)
    try:
        answer = searches.solve(key.title, case.table, config, stopwatch.watch)
    except AtollError as error:
        searches.check()  # without a coordinator no job is to blame
        seconds = {"seconds": time.monotonic() - begun}
        journal.add(judge_job(key, case, seconds, stopwatch, str(error)), None)
        return
    journal.add(judge_job(key, case, answer, stopwatch, config=config), answer)


def _solve_otherwise(key: Key, journal: Journal[Outcome]) -> None:
    """Do a job by another program in this process, which is given the same table."""
    case, begun, stopwatch = make_case(key), time.process_time(), Stopwatch()
    try:
        answer = _answer_otherwise(key, case)
    except AtollError as error:
        journal.add(judge_job(key, case, {}, stopwatch, str(error)), None)
        return
    stopwatch.processor[key.method] = time.process_time() - begun
    journal.add(judge_job(key, case, answer, stopwatch), answer)


def _answer_otherwise(key: Key, case: Case) -> dict[str, Any]:
    if key.method == operon_models.OPERON:
        return operon_models.solve(case.table, configuration(key, case, None, {}).space.operators, key.seed)
    its = noise.Case(case.table, case.system.truths, case.clean, noise.Path(np.zeros(0), np.zeros((0, 0))))
    return pysindy_models.solve(noise.Key(key.method, "plain", key.system, 0.0, key.seed), its)


def line(outcome: Outcome) -> str:
    """Return how one job came out, for following a long run."""
    marks = ", ".join(
        f"{its.variable} {its.form}{f' {its.extra}' if its.extra else ''} {its.grade or '-'} R2 {_two(its.r2)}"
        for its in outcome.equations
    )
    phases = " + ".join(f"{name} {seconds:.1f}" for name, seconds in outcome.cpu.items() if seconds >= 0.05)
    failure = f"; {outcome.failure}" if outcome.failure else ""
    return f"{outcome.key.title} ({outcome.system}): {marks}; {outcome.seconds:.1f} s, cpu {phases}{failure}"


def _two(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
