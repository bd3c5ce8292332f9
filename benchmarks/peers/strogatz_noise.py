"""How often the 14 Strogatz equations are solved from 300 rows with noise on the label: SRBench's protocol."""

import statistics
from argparse import Namespace
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from atoll.terminal.output import count, note, say, table
from atoll_core.config import JobConfig
from atoll_core.errors import AtollError
from benchmarks.harness.record import Record
from benchmarks.harness.service import Searches
from benchmarks.harness.tables import grouped
from benchmarks.judging.errors import finite
from benchmarks.judging.rules import right_ones
from benchmarks.peers.srbench import assess, compare_strictly
from benchmarks.peers.strogatz_files import Split, rows_of, split

PUBLISHED: Final = {
    0.0: ("85.7 (PySR, 8 h)", 85.7, "20.0", "11.4"),
    0.001: ("22.1 (AIFeynman, 8 h)", 22.1, "15.7", "5.0"),
    0.01: ("50.0 (ParFam, 3.4 h)", 50.0, "13.6", "0.7"),
    0.1: ("15.0 (DSR, 410 s)", 15.0, "2.1", "0"),
}
"""By noise: the highest published rate of solutions in %, and those of AFP_FE and Operon.

Of the methods, AFP_FE alone evolves fitness predictors; its figures, Operon's, AIFeynman's and DSR's are from the
results of SRBench (La Cava et al. 2021, ten runs for each file). PySR and ParFam were run once for each file.
"""


NOTHING: Final[Mapping[str, Any]] = {
    "equations": ({"expression": None, "front": (), "complexity": None, "why": None, "point_evaluations": 0},),
    "search_seconds": 0.0,
    "seconds": 0.0,
}
"""The result of a job that has none."""


@dataclass(frozen=True)
class Outcome:
    """How one search came out by both rules.

    `on_front` is the complexity of the smallest member of the front that the strict rule credits, None if none;
    `constants_error` the largest relative error of a constant, None when terms differ. Times are in seconds.
    """

    file: str
    seed: int
    level: float
    srbench: bool
    srbench_reason: str
    strict: bool
    strict_reason: str
    r_squared: float | None
    constants_error: float | None
    on_front: int | None
    expression: str | None
    complexity: int | None
    why: str | None
    point_evaluations: int
    search_seconds: float
    seconds: float

    @property
    def is_on_front(self) -> bool:
        """Whether the front has an equation that the strict rule credits."""
        return self.on_front is not None


def run(
    searches: Searches, options: Namespace, configs: Mapping[int, JobConfig], known: Mapping[str, str], records: Record
) -> int:
    """Search all files at all levels with the configuration of each seed and print how often they were solved.

    Returns 0 when the rate exceeds the highest published one at each level that has one.
    """
    outcomes: list[Outcome] = []
    for level in options.noise:
        for name in options.file or known:
            for seed in options.seeds:
                rows = split(rows_of(options.data, name), name, seed, level)
                title = f"{name} noise {level:g} seed {seed}"
                try:
                    result: Mapping[str, Any] = searches.solve(title, rows.training, configs[seed])
                except AtollError as error:  # no equation in the time that is allowed is a miss
                    note(str(error))
                    result = NOTHING
                outcomes.append(outcome(result, rows, (name, seed, level), known[name]))
                records.add(outcomes[-1])
                note(_line(title, outcomes[-1]))
    searched = grouped(outcomes, lambda outcome: outcome.level)
    records.write(rates={f"{level:g}": rates(runs) for level, runs in searched.items()})
    say(by_file(outcomes))
    say("\n" + by_level(outcomes))
    return 0 if all(map(_is_ahead, searched.values())) else 1


def outcome(result: Mapping[str, Any], rows: Split, key: tuple[str, int, float], truth: str) -> Outcome:
    """Judge the equation in `result` (the contents of a result.json) of the search `key`: file, seed and level."""
    (equation,) = result["equations"]
    file, seed, level = key
    strictly = partial(compare_strictly, truth=truth, columns=rows.columns)
    text = equation["expression"] or None
    by_srbench, strict = assess(text, truth, rows.columns, rows.labels), strictly(text)
    return Outcome(
        file=file,
        seed=seed,
        level=level,
        srbench=by_srbench.is_right,
        srbench_reason=by_srbench.reason if text else "no equation",
        strict=strict.is_right,
        strict_reason=strict.reason if text else "no equation",
        r_squared=finite(by_srbench.r_squared),
        constants_error=strict.constants_error,
        on_front=min((member["complexity"] for member in right_ones(strictly, equation["front"])), default=None),
        expression=text,
        complexity=equation["complexity"],
        why=equation["why"],
        point_evaluations=equation["point_evaluations"],
        search_seconds=result["search_seconds"],
        seconds=result["seconds"],
    )


def rates(outcomes: Sequence[Outcome]) -> dict[str, float]:
    """Return the shares in % of `outcomes` solved by each rule, and with an equation on the front that is, strictly."""
    whole = 100.0 / len(outcomes)
    return {
        "srbench": whole * sum(outcome.srbench for outcome in outcomes),
        "strict": whole * sum(outcome.strict for outcome in outcomes),
        "on_front": whole * sum(outcome.is_on_front for outcome in outcomes),
    }


def by_file(outcomes: Sequence[Outcome]) -> str:
    """Return a table with a row for each file and level."""
    heads = ("file", "noise", "SRBench", "strict", "on front", "median s", "longest s", "evaluations")
    rows = []
    searched = grouped(outcomes, lambda outcome: (outcome.file, outcome.level))
    for (file, level), runs in sorted(searched.items(), key=lambda item: item[0][1]):
        seconds = [run.seconds for run in runs]
        counts = (sum(getattr(run, rule) for run in runs) for rule in ("srbench", "strict", "is_on_front"))
        numbers = (f"{number} of {len(runs)}" for number in counts)
        times = (f"{statistics.median(seconds):.1f}", f"{max(seconds):.1f}")
        evaluations = count(statistics.median(run.point_evaluations for run in runs))
        rows.append((file, f"{level:g}", *numbers, *times, evaluations))
    return table(heads, rows)


def by_level(outcomes: Sequence[Outcome]) -> str:
    """Return a table of the rates in % beside the published ones."""
    heads = (
        "noise",
        "runs",
        "SRBench %",
        "strict %",
        "on front %",
        "median s",
        "highest published %",
        "AFP_FE",
        "Operon",
    )
    rows = []
    for level, runs in sorted(grouped(outcomes, lambda outcome: outcome.level).items()):
        best, _, coevolved, operon = PUBLISHED.get(level, ("-", 0.0, "-", "-"))
        share = (f"{rate:.1f}" for rate in rates(runs).values())
        seconds = f"{statistics.median(run.seconds for run in runs):.1f}"
        rows.append((f"{level:g}", str(len(runs)), *share, seconds, best, coevolved, operon))
    return table(heads, rows)


def _is_ahead(outcomes: Sequence[Outcome]) -> bool:
    published = PUBLISHED.get(outcomes[0].level)
    return published is None or rates(outcomes)["srbench"] > published[1]


def _line(title: str, searched: Outcome) -> str:
    rules = {"SRBench": searched.srbench, "strict": searched.strict}
    marks = [f"{rule} {'yes' if is_solved else 'no'}" for rule, is_solved in rules.items()]
    front = "" if searched.strict or searched.on_front is None else f" (on the front at size {searched.on_front})"
    return f"{title}: {', '.join(marks)}{front} in {searched.seconds:.1f} s: {searched.expression}"
