"""All searches that are asked for, one after another, and the table of what came of them."""

from argparse import Namespace
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial

from atoll.terminal.output import say, table
from atoll_core.config import JobConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table
from atoll_core.errors import UsageError
from benchmarks.dysts.flows import NEVER_POLYNOMIAL, load
from benchmarks.dysts.making import POLYNOMIAL
from benchmarks.harness.campaign import Service, attempt, journal_of, work_off
from benchmarks.harness.jobs import configured
from benchmarks.harness.journal import read
from benchmarks.harness.stopwatch import Stopwatch
from benchmarks.harness.systems import table_of
from benchmarks.judging.forms import judge_form
from benchmarks.many.systems import SYSTEMS, sampled

Key = tuple[str, float, int]
"""System, noise in percent, seed."""


@dataclass(frozen=True)
class Outcome:
    """One search: the form of each equation (see `benchmarks.judging.forms`), its verdict, what was shown.

    `seconds` are those of the job, `phases` those of its states, `processor` processor seconds of these.
    """

    system: str
    noise: float
    seed: int
    forms: tuple[str, ...]
    verdicts: tuple[str | None, ...]
    equations: tuple[str | None, ...]
    seconds: float
    phases: Mapping[str, float]
    processor: Mapping[str, float]
    failure: str | None = None

    @property
    def key(self) -> Key:
        """What was searched."""
        return self.system, self.noise, self.seed

    @property
    def right(self) -> int:
        """How many equations have the truth's form."""
        return self.forms.count("right")


@dataclass(frozen=True, eq=False)
class Case:
    """What is searched and judged: a table, the true equations by state, all variables without noise by name."""

    table: Table
    config: JobConfig
    equations: dict[str, str]
    columns: dict[str, FloatArray]


def keys(options: Namespace) -> list[Key]:
    """Return all searches that are asked for."""
    return [(name, noise, seed) for name in options.systems for noise in options.noise for seed in options.seeds]


def run(options: Namespace) -> None:
    """Search what the journal does not have, print the table."""
    journal = journal_of("many", Outcome, options)
    say(_table(work_off(keys(options), journal, partial(_one, options), _line, options.workers)))


def show(options: Namespace) -> None:
    """Print the table of a file."""
    say(_table(read(options.file, Outcome).values()))


def case(name: str, noise: float, seed: int, options: Namespace) -> Case:
    """Return what is searched; raises UsageError for an unknown name."""
    budget = {"max_time": options.max_time}
    if name in SYSTEMS:
        system = SYSTEMS[name] if options.runs is None else replace(SYSTEMS[name], runs=options.runs)
        runs, whole = sampled(system, seed, noise)
        columns = dict(zip(system.names, whole, strict=True))
        return Case(table_of(runs), configured(seed, {"order": system.order}, budget), dict(system.equations), columns)
    if options.dysts is None:
        raise UsageError(f"{name} is none of {', '.join(SYSTEMS)}; flows of dysts need --dysts DIR")
    flow = load(options.dysts, name)
    config = configured(seed, {}, budget, None if name in POLYNOMIAL else NEVER_POLYNOMIAL)
    columns = dict(zip(flow.states, flow.train.reshape(-1, len(flow.states)).T, strict=True))
    equations = dict(zip(flow.states, flow.equations, strict=True))
    return Case(flow.table(noise, seed), config, equations, columns)


def _one(options: Namespace, service: Service, key: Key) -> tuple[Outcome, None]:
    name, noise, seed = key
    searched, stopwatch = case(name, noise, seed, options), Stopwatch(counts=True)
    job = attempt(service(), f"{name} {noise:g} % seed {seed}", searched.table, searched.config, stopwatch)
    equations = {equation["variable"]: equation for equation in job.result.get("equations", ())}
    texts = [equations.get(state, {}).get("expression") for state in searched.equations]
    forms = tuple(
        judge_form(text, truth, searched.columns, with_extra=False).kind
        for text, truth in zip(texts, searched.equations.values(), strict=True)
    )
    verdicts = tuple(equations.get(state, {}).get("verdict") for state in searched.equations)
    seconds = job.seconds if job.failure else float(job.result.get("seconds") or 0.0)
    reason = job.failure or job.result.get("reason")
    return Outcome(*key, forms, verdicts, tuple(texts), seconds, stopwatch.seconds, stopwatch.processor, reason), None


def _line(outcome: Outcome) -> str:
    """Return one search in a line, with the equations that are not right."""
    wrong = (f"{form}: {text}" for form, text in zip(outcome.forms, outcome.equations, strict=True) if form != "right")
    return " | ".join([*_cells(outcome), *wrong])


def _table(outcomes: Iterable[Outcome]) -> str:
    heads = ("system", "noise %", "seed", "right", "s", "cpu s by state", "verdicts")
    return table(heads, [_cells(outcome) for outcome in outcomes])


def _cells(outcome: Outcome) -> tuple[str, ...]:
    processor = ", ".join(f"{state} {seconds:.0f}" for state, seconds in outcome.processor.items())
    verdicts = [verdict or "none" for verdict in outcome.verdicts]
    counts = ", ".join(f"{verdicts.count(verdict)} {verdict}" for verdict in sorted(set(verdicts)))
    return (
        outcome.system,
        f"{outcome.noise:g}",
        str(outcome.seed),
        f"{outcome.right}/{len(outcome.forms)}",
        f"{outcome.seconds:.0f}",
        processor,
        counts if outcome.failure is None else f"{counts} ({outcome.failure})",
    )
