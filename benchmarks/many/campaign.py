"""All searches that are asked for, one after another, and the table of what came of them."""

import argparse
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from atoll.config import PRESETS, JobConfig
from atoll.data.dataset import FloatArray
from atoll.data.table import Table
from atoll.errors import AtollError, UsageError
from atoll_coordinator.cli.terminal.output import note, say, table
from benchmarks.corpus.forms import judge_form
from benchmarks.dysts.flows import NEVER_POLYNOMIAL, load
from benchmarks.dysts.making import POLYNOMIAL
from benchmarks.harness.command_line import plain_errors
from benchmarks.harness.journal import Journal, read
from benchmarks.harness.service import Searches, searching
from benchmarks.harness.stopwatch import Stopwatch
from benchmarks.kernels.derivatives import table_of
from benchmarks.many.outcomes import Outcome
from benchmarks.many.systems import SYSTEMS, sampled


@dataclass(frozen=True, eq=False)
class Case:
    """What is searched and judged: a table, the true equations by state, all variables without noise by name."""

    table: Table
    config: JobConfig
    equations: dict[str, str]
    columns: dict[str, FloatArray]


def run(options: argparse.Namespace, arguments: Sequence[str]) -> int:
    """Search what the journal does not have, print the table."""
    with plain_errors("benchmarks.many"):
        journal = Journal("many", Outcome, options.resume or options.out, arguments, resume=options.resume is not None)
        wanted = [(name, noise, seed) for name in options.systems for noise in options.noise for seed in options.seeds]
        missing = [key for key in wanted if key not in journal.outcomes]
        note(f"{len(wanted)} searches, {len(wanted) - len(missing)} of them done before")
        if missing:
            with searching(options.workers) as searches:
                for name, noise, seed in missing:
                    outcome = _one(searches, name, noise, seed, options)
                    journal.add(outcome)
                    note(_line(outcome))
        say(_table(journal.outcomes[key] for key in wanted))
    return 0


def show(path: Path) -> int:
    """Print the table of a file."""
    with plain_errors("benchmarks.many"):
        say(_table(read(path, Outcome).values()))
    return 0


def case(name: str, noise: float, seed: int, options: argparse.Namespace) -> Case:
    """Return what is searched; raises UsageError for an unknown name."""
    config = PRESETS["default"].model_copy(update={"seed": seed})
    config = config.model_copy(update={"budget": config.budget.model_copy(update={"max_time": options.max_time})})
    if name in SYSTEMS:
        system = SYSTEMS[name] if options.runs is None else replace(SYSTEMS[name], runs=options.runs)
        runs, whole = sampled(system, seed, noise)
        config = config.model_copy(update={"data": config.data.model_copy(update={"order": system.order})})
        columns = dict(zip(system.names, whole, strict=True))
        return Case(table_of(runs), config, dict(system.equations), columns)
    if options.dysts is None:
        raise UsageError(f"{name} is none of {', '.join(SYSTEMS)}; flows of dysts need --dysts DIR")
    flow = load(options.dysts, name)
    if name not in POLYNOMIAL:
        space = config.space.model_copy(update={"operators": NEVER_POLYNOMIAL})
        config = config.model_copy(update={"space": space})
    columns = dict(zip(flow.states, flow.train.reshape(-1, len(flow.states)).T, strict=True))
    equations = dict(zip(flow.states, flow.equations, strict=True))
    return Case(flow.table(noise, seed), config, equations, columns)


def _one(searches: Searches, name: str, noise: float, seed: int, options: argparse.Namespace) -> Outcome:
    its = case(name, noise, seed, options)
    stopwatch, begun = Stopwatch(counts=True), time.monotonic()
    try:
        result = searches.solve(f"{name} {noise:g} % seed {seed}", its.table, its.config, stopwatch.watch)
    except AtollError as error:
        searches.check()  # without a coordinator no job is to blame
        nothing, seconds = (None,) * len(its.equations), time.monotonic() - begun
        forms = ("none",) * len(its.equations)
        return Outcome(
            name, noise, seed, forms, nothing, nothing, seconds, stopwatch.seconds, stopwatch.processor, str(error)
        )
    found = {equation["variable"]: equation for equation in result["equations"]}
    texts = [found.get(state, {}).get("expression") for state in its.equations]
    forms = tuple(
        judge_form(text, truth, its.columns, with_extra=False).kind
        for text, truth in zip(texts, its.equations.values(), strict=True)
    )
    return Outcome(
        name, noise, seed, forms, tuple(found.get(state, {}).get("verdict") for state in its.equations), tuple(texts),
        float(result.get("seconds") or 0.0), stopwatch.seconds, stopwatch.processor, result.get("reason"),
    )  # fmt: skip


def _line(outcome: Outcome) -> str:
    """Return one search in a line, with the equations that are not right."""
    wrong = (f"{form}: {text}" for form, text in zip(outcome.forms, outcome.equations, strict=True) if form != "right")
    return " | ".join([*_cells(outcome), *wrong])


def _table(outcomes: Iterable[Outcome]) -> str:
    heads = ("system", "noise %", "seed", "right", "s", "cpu s by state", "verdicts")
    return table(heads, [_cells(each) for each in outcomes])


def _cells(outcome: Outcome) -> tuple[str, ...]:
    processor = ", ".join(f"{state} {seconds:.0f}" for state, seconds in outcome.processor.items())
    verdicts = [each or "none" for each in outcome.verdicts]
    counts = ", ".join(f"{verdicts.count(each)} {each}" for each in sorted(set(verdicts)))
    return (
        outcome.system,
        f"{outcome.noise:g}",
        str(outcome.seed),
        f"{outcome.right}/{len(outcome.forms)}",
        f"{outcome.seconds:.0f}",
        processor,
        counts if outcome.failure is None else f"{counts} ({outcome.failure})",
    )
