"""Many jobs of the corpus, one after the other on warm processes, kept in a file from which they can be resumed.

The file has JSON lines: the machine and the options of each run, and each job with its outcome and its answer, so that
it can be judged anew without searching again.
"""

import json
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from atoll.config import PRESETS, JobConfig
from atoll.errors import AtollError, DataError, UsageError
from atoll_coordinator.cli.terminal.output import note
from benchmarks.corpus.cases import OURS, Case, Key, make_case
from benchmarks.corpus.outcomes import Meter, Outcome, judge_job, outcome_from
from benchmarks.harness.record import head, load
from benchmarks.harness.service import Searches, searching
from benchmarks.harness.stopwatch import Stopwatch
from benchmarks.noise import data as noise
from benchmarks.noise.journal import kept_of
from benchmarks.peers import operon_models, pysindy_models


class CorpusJournal:
    """The jobs that have ended, by key; written as they come."""

    def __init__(self, path: Path | None, arguments: Sequence[str]) -> None:
        """Begin the file `path` (None: no file), or continue it when it exists.

        Raises:
            UsageError: it cannot be written.
            DataError: it holds something else.
        """
        self.outcomes: dict[Key, Outcome] = {}
        self.answers: dict[Key, Mapping[str, Any]] = {}
        self._path = path
        if path is not None and path.exists():
            self._read(path)
        self._write({"head": head("corpus", arguments)})

    def add(self, outcome: Outcome, answer: Mapping[str, Any] | None) -> None:
        """Take in a job that has ended, with the contents of its result.json if it has one."""
        kept = kept_of(answer) if answer else None
        self._take(outcome, kept)
        self._write({"outcome": outcome.to_json(), "answer": kept})

    def _take(self, outcome: Outcome, answer: Mapping[str, Any] | None) -> None:
        self.outcomes[outcome.key] = outcome
        if answer is not None:
            self.answers[outcome.key] = answer

    def _write(self, value: Mapping[str, Any]) -> None:
        if self._path is None:
            return
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(value, ensure_ascii=False) + "\n")
        except OSError as error:
            raise UsageError(f"{self._path} cannot be written ({error.strerror}); name another file") from error

    def _read(self, path: Path) -> None:
        """Take in what `path` holds, and cut off a last line that was not written to its end."""
        text = path.read_text("utf-8")
        whole = text[: text.rfind("\n") + 1]
        if whole != text:
            path.write_text(whole, "utf-8")
        for number, line in enumerate(whole.splitlines(), start=1):
            try:
                value = json.loads(line)
                if "outcome" in value:
                    self._take(outcome_from(value["outcome"]), value["answer"])
            except (ValueError, TypeError, KeyError) as error:
                message = f"line {number} of {path} is no job of this benchmark; name a file that --out has written"
                raise DataError(message) from error


def run_jobs(
    keys: Sequence[Key], journal: CorpusJournal, workers: int, max_time: float | None, changes: Mapping[str, Any]
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


def judge_again(keys: Sequence[Key], journal: CorpusJournal) -> None:
    """Judge what the journal has of `keys` by the present rules; what the jobs took stays."""
    for key in keys:
        answer = journal.answers.get(key)
        if answer is not None:
            old = journal.outcomes[key]
            meter = Meter((), Stopwatch(seconds=dict(old.wall)), dict(old.cpu))
            case = make_case(key)
            journal.add(judge_job(key, case, answer, meter, config=configuration(key, case, None, {})), answer)


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
    searches: Searches, key: Key, journal: CorpusJournal, max_time: float | None, changes: Mapping[str, Any]
) -> None:
    case, meter, begun = make_case(key), Meter(searches.pids), time.monotonic()
    config = configuration(key, case, max_time, changes)
    try:
        answer = searches.solve(key.title, case.table, config, meter.watch)
    except AtollError as error:
        searches.check()  # without a coordinator no job is to blame
        seconds = {"seconds": time.monotonic() - begun}
        journal.add(judge_job(key, case, seconds, meter, str(error)), None)
        return
    journal.add(judge_job(key, case, answer, meter, config=config), answer)


def _solve_otherwise(key: Key, journal: CorpusJournal) -> None:
    """Do a job by another program in this process, which is given the same table."""
    case, begun, meter = make_case(key), time.process_time(), Meter(())
    try:
        answer = _answer_otherwise(key, case)
    except AtollError as error:
        journal.add(judge_job(key, case, {}, meter, str(error)), None)
        return
    meter.cpu[key.method] = time.process_time() - begun
    journal.add(judge_job(key, case, answer, meter), answer)


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
