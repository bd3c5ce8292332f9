"""Many jobs of the corpus, one after the other on warm processes, kept in a file from which they can be resumed."""

import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from atoll.terminal.output import note
from atoll_core.config import BASE_OPERATORS, JobConfig, PriorConfig
from atoll_core.data.table import Table
from atoll_core.errors import AtollError
from benchmarks.corpus.cases import KNOWN_PART, OURS, UNTOLD, Case, Key, make_case, with_unknown_summand
from benchmarks.corpus.outcomes import Outcome, judge_job
from benchmarks.harness import campaign
from benchmarks.harness.campaign import Answer, Service, attempt, work_off
from benchmarks.harness.jobs import configured
from benchmarks.harness.journal import Journal
from benchmarks.harness.parallel import in_parallel
from benchmarks.harness.stopwatch import Stopwatch
from benchmarks.harness.tables import Columns
from benchmarks.noise import data as noise
from benchmarks.peers import operon_models, pysindy_models
from benchmarks.pools.stored import file_of, read_pools, refine_stored


def run_jobs(
    keys: Sequence[Key], journal: Journal[Outcome], workers: int, max_time: float | None, changes: Mapping[str, Any]
) -> list[Outcome]:
    """Do the jobs that the journal does not have; return the outcomes of all. `changes` are of the configuration."""

    def do(service: Service, key: Key) -> tuple[Outcome, Answer]:
        is_ours = key.method in (OURS, UNTOLD, KNOWN_PART)
        case, stopwatch, begun = make_case(key), Stopwatch(counts=is_ours), time.process_time()
        if is_ours:
            config = configuration(key, case, max_time, changes)
            job = attempt(service(), key.title, case.table, config, stopwatch)
            if job.failure is None:
                return judge_job(key, case, job.result, stopwatch, config=config), job.result
            return judge_job(key, case, {"seconds": job.seconds}, stopwatch, job.failure), None
        try:
            answer = _answer_otherwise(key, case)
        except AtollError as error:
            return judge_job(key, case, {}, stopwatch, str(error)), None
        stopwatch.processor[key.method] = time.process_time() - begun
        return judge_job(key, case, answer, stopwatch), answer

    return work_off(keys, journal, do, line, workers)


def request_of(key: Key, max_time: float | None) -> tuple[Table, JobConfig]:
    """Return the table of a job and its configuration."""
    case = make_case(key)
    return case.table, configuration(key, case, max_time, {})


def refine_all_pools(
    keys: Sequence[Key], journal: Journal[Outcome], folder: Path, workers: int, max_time: float | None
) -> list[Outcome]:
    """Refine the stored pools of `keys` that the journal does not have; return the outcomes of all."""
    missing = [key for key in keys if key not in journal.outcomes]
    for outcome in in_parallel(partial(_refine_pool, folder=folder, max_time=max_time), missing, workers):
        journal.add(outcome)
        note(line(outcome))
    return [journal.outcomes[key] for key in keys if key in journal.outcomes]


def _refine_pool(key: Key, folder: Path, max_time: float | None) -> Outcome:
    case = make_case(key)
    config = configuration(key, case, None, {})
    refined = refine_stored(key.title, case.table, config, read_pools(file_of(folder, key.title)), max_time)
    stopwatch = Stopwatch(seconds={"refining": refined.wall_s}, processor={"refining": refined.refining_s})
    return judge_job(key, case, refined.result, stopwatch, config=config)


def judge_again(keys: Sequence[Key], journal: Journal[Outcome]) -> None:
    """Judge what the journal has of `keys` by the present rules; what the jobs took stays."""

    def judge(key: Key, old: Outcome, answer: Mapping[str, Any]) -> Outcome:
        stopwatch = Stopwatch(seconds=dict(old.wall), processor=dict(old.cpu))
        case = make_case(key)
        return judge_job(key, case, answer, stopwatch, config=configuration(key, case, None, {}))

    campaign.judge_again(keys, journal, judge)


def configuration(key: Key, case: Case, max_time: float | None, changes: Mapping[str, Any]) -> JobConfig:
    """Return the default configuration with the functions that the truth needs, unless it is not to be told."""
    operators = None if key.method == UNTOLD else (*BASE_OPERATORS, *case.system.operators)
    config = configured(key.seed, case.data, {"max_time": max_time, **changes}, operators)
    if key.method != KNOWN_PART:
        return config
    _, equations = with_unknown_summand(case.system, key.seed)
    return config.model_copy(update={"prior": PriorConfig(equations=equations)})


def _answer_otherwise(key: Key, case: Case) -> dict[str, Any]:
    if key.method == operon_models.OPERON:
        operators = configuration(key, case, None, {}).space.operators or BASE_OPERATORS
        return operon_models.solve(case.table, operators, key.seed)
    measured = noise.Case(case.table, case.system.truths, case.clean, ())
    return pysindy_models.solve(key.method, key.seed, measured)


EQUATION: Final = Columns("variable | form={shown_form} | grade | R2=R2 {r2:.2f}")


def line(outcome: Outcome) -> str:
    """Return how one job came out, for following a long run."""
    marks = ", ".join(map(" ".join, map(EQUATION.row, outcome.equations)))
    phases = " + ".join(f"{name} {seconds:.1f}" for name, seconds in outcome.cpu.items() if seconds >= 0.05)
    failure = f"; {outcome.failure}" if outcome.failure else ""
    return f"{outcome.key.title} ({outcome.system}): {marks}; {outcome.seconds:.1f} s, cpu {phases}{failure}"
