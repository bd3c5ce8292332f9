"""The jobs whose pools are stored: their tables by name, and how a result of each is judged.

A title is a kind and words, such as ``corpus random 2 4 even noise-0.01 1605``. The benchmark of that kind generates
the table, or reads it from a folder that is named on the command line, and judges the result.
"""

import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from atoll.cli.request import JobRequest
from atoll_coordinator.data.reading.files import read_table
from atoll_core.config import DataConfig, JobConfig
from atoll_core.data.table import Table
from atoll_core.errors import UsageError
from benchmarks.corpus import cases as corpus
from benchmarks.corpus.campaign import configuration
from benchmarks.corpus.outcomes import judge_job
from benchmarks.first_hour import campaign as first_hour_campaign
from benchmarks.first_hour.cases import CASES as FIRST_HOUR
from benchmarks.first_hour.outcomes import CONFIDENT
from benchmarks.first_hour.outcomes import judge as judge_first_hour
from benchmarks.harness.jobs import configured
from benchmarks.harness.systems import table_of
from benchmarks.judging.forms import judge_form
from benchmarks.many.systems import SYSTEMS, sampled
from benchmarks.real.cases import CASES as REAL
from benchmarks.stochastic import judging as stochastic
from benchmarks.stochastic.processes import PROCESSES, simulate
from benchmarks.stochastic.processes import sampled as sampled_paths
from benchmarks.verdicts import campaign as verdicts
from benchmarks.verdicts import cases as listed
from benchmarks.verdicts.judging import Key, judge

NONE: Final = "no model"
LISTED_VARIABLE: Final = "ATOLL_CASES"
REAL_VARIABLE: Final = "ATOLL_REAL_DATA"


@dataclass(frozen=True)
class Judged:
    """One equation of a result: whether it has the form of the law (None: no law is known), and its grade.

    `is_false`: the grade is too good, by the rules of the table's benchmark.
    """

    variable: str
    is_right: bool | None
    grade: str
    is_false: bool = False
    expression: str | None = None


@dataclass(frozen=True)
class Folders:
    """Folders of tables: one with cases.json, one with real measurements; None where not given."""

    listed: Path | None = None
    real: Path | None = None


Result = Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Job:
    """The table and configuration of a stored pool, and the judge of its refined result."""

    table: Table
    config: JobConfig
    judge: Callable[[Result], list[Judged]]


def job_of(title: str, folders: Folders) -> Job:
    """Return the job of a title; equal titles give equal jobs.

    Raises:
        UsageError: The kind is unknown, or the table needs a folder that was not given.
        DataError: The table cannot be read.
    """
    kind, *words = shlex.split(title)
    if kind not in KINDS:
        raise UsageError(f"{kind!r} is not a kind of pool; expected one of {', '.join(KINDS)}")
    return KINDS[kind](words, folders)


def _corpus(words: Sequence[str], _folders: Folders) -> Job:
    system, states, trajectories, sampling, quality, seed = words
    key = corpus.Key(system, int(states), int(trajectories), sampling, quality, int(seed))
    case = corpus.make_case(key)
    config = configuration(key, case, None, {})

    def judged(result: Result) -> list[Judged]:
        return [
            Judged(one.variable, one.is_right, one.grade or NONE,
                   not one.is_right and (one.grade == "exact" or (one.grade == "good" and one.is_foretold is False)),
                   one.expression)
            for one in judge_job(key, case, result).equations
        ]  # fmt: skip

    return Job(case.table, config, judged)


def _verdicts(words: Sequence[str], _folders: Folders) -> Job:
    campaign, seed, *variant = words
    drawn = verdicts.table_of(Key(campaign, int(seed), *variant))
    with TemporaryDirectory() as folder:
        table, config = _read(verdicts.request(drawn.csv(), drawn.words, Path(folder)))

    def judged(result: Result) -> list[Judged]:
        return [
            Judged(one.variable, None if one.law is None else one.is_right, one.grade, one.is_false, one.expression)
            for one in judge(drawn, result)
        ]

    return Job(table, config, judged)


def _many(words: Sequence[str], _folders: Folders) -> Job:
    name, noise, seed = words
    system = SYSTEMS[name]
    runs, whole = sampled(system, int(seed), float(noise))
    columns = dict(zip(system.names, whole, strict=True))

    def judged(result: Result) -> list[Judged]:
        shown = {equation["variable"]: equation for equation in result["equations"]}
        return [_of_form(shown.get(state, {}), state, truth, columns) for state, truth in system.equations.items()]

    return Job(table_of(runs), configured(int(seed), {"order": system.order}), judged)


def _of_form(equation: Mapping[str, Any], state: str, truth: str, columns: Mapping[str, Any]) -> Judged:
    text, grade = equation.get("expression"), equation.get("verdict") or NONE
    is_right = judge_form(text, truth, columns, with_extra=False).kind == "right"
    return Judged(state, is_right, grade, grade == "exact" and not is_right, text)


def _stochastic(words: Sequence[str], _folders: Folders) -> Job:
    name, seed = words
    process = PROCESSES[name]
    paths = simulate(process, int(seed))
    config = JobConfig(seed=int(seed), data=DataConfig(stochastic=True))

    def judged(result: Result) -> list[Judged]:
        equations = stochastic.judge(name, process, int(seed), np.concatenate(paths, axis=1), result["equations"])
        return [
            Judged(one.equation, one.is_right, one.verdict or NONE, one.verdict in CONFIDENT and not one.is_right,
                   one.found)
            for one in equations
        ]  # fmt: skip

    return Job(table_of(sampled_paths(process, paths)), config, judged)


def _first_hour(words: Sequence[str], _folders: Folders) -> Job:
    case = FIRST_HOUR[" ".join(words)]
    with TemporaryDirectory() as folder:
        table, config = _read(first_hour_campaign.request(case, Path(folder)))

    def judged(result: Result) -> list[Judged]:
        return [
            Judged(one.state, None if one.law is None else one.is_found, one.verdict or NONE,
                   one.is_confident and not one.is_found, one.expression)
            for one in judge_first_hour(case, result)
        ]  # fmt: skip

    return Job(table, config, judged)


def _case(words: Sequence[str], folders: Folders) -> Job:
    if folders.listed is None:
        raise UsageError(f"the table of case {words[0]} is read from a folder with cases.json; name it with --cases")
    name = shlex.join(words)
    case = next((one for one in listed.cases_of(folders.listed) if shlex.join(shlex.split(one.name)) == name), None)
    if case is None:
        raise UsageError(f"{folders.listed / listed.LIST} has no case {name}")
    table, config = _read(case.request(folders.listed))
    columns = listed.columns_of(case, folders.listed)

    def judged(result: Result) -> list[Judged]:
        return [
            Judged(one.variable, None if one.form is None else one.form == "right", one.grade,
                   one.grade in CONFIDENT and not one.is_allowed and one.form != "right", one.expression)
            for one in listed.judged(case, columns, result)
        ]  # fmt: skip

    return Job(table, config, judged)


def _real(words: Sequence[str], folders: Folders) -> Job:
    if folders.real is None:
        raise UsageError(f"the measurements of {' '.join(words)} are read from a folder; name it with --real")
    case = next(one for one in REAL if one.name == " ".join(words))

    def judged(result: Result) -> list[Judged]:
        return [
            Judged(one["variable"], None, one.get("verdict") or NONE, expression=one.get("expression"))
            for one in result["equations"]
        ]

    return Job(case.table(folders.real), case.config(0, None), judged)


def _read(request: JobRequest) -> tuple[Table, JobConfig]:
    return read_table(request.files, request.config.data), request.config


KINDS: Final[Mapping[str, Callable[[Sequence[str], Folders], Job]]] = {
    "corpus": _corpus,
    "verdicts": _verdicts,
    "many": _many,
    "stochastic": _stochastic,
    "first-hour": _first_hour,
    "case": _case,
    "real": _real,
}
