"""Table III of Schmidt & Lipson 2008: the 14 equations of its seven systems, each sought alone, beside its own figures.

``python -m benchmarks.paper.table3 --seeds 0-4`` samples four trajectories of 100 points at a step of 0.1 with data
seed k, as the paper did, and searches every equation by itself (``--only``) with search seed k, on a coordinator and
two workers. Twice: with the exact derivatives given (column ``given``), as the paper had them, and with derivatives
that are estimated from the states (``estimated``).

An equation counts as found when it is exact in form (``benchmarks.judging.forms``). Medians are over seeds, a search
that did not find its equation counting as infinitely long. Seconds are those of the search alone; job seconds, from
submission to the end, are what is compared with the paper's.
"""

import itertools
import math
import statistics
import sys
from argparse import Namespace
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Final, Literal

import numpy as np

from atoll.terminal.output import clipped, note, say, shortened
from atoll_coordinator.data.prepare import prepare
from atoll_core.config import PRESETS, JobConfig
from atoll_core.data.table import Table
from atoll_core.errors import UsageError
from benchmarks.harness import jobs
from benchmarks.harness.command_line import option, positive, program, search_options
from benchmarks.harness.report import Report
from benchmarks.harness.service import Searches, searching
from benchmarks.harness.systems import SYSTEMS, TABLE_III, TRUTH, Sampled, table_of, trajectories
from benchmarks.harness.tables import Columns
from benchmarks.judging.verdict import Question, Verdict, judged, miss
from benchmarks.peers.strogatz import PUBLISHED

STEP: Final = 0.1
"""Sampling step of the paper; with 10 time units, 100 points on a trajectory."""

SLOPE: Final = "slope_of_"
Derivatives = Literal["given", "estimated"]
COLUMNS: Final[tuple[Derivatives, ...]] = ("given", "estimated")

EQUATIONS: Final = tuple((system, variable) for system in TABLE_III for variable in TRUTH[system])
"""System and variable of each equation, in the order of the paper's table."""

PAPER: Final = dict(zip(EQUATIONS, PUBLISHED.values(), strict=True))
"""Seconds (8 processors of 2008, one run) and point evaluations of each row of the paper's table."""


@dataclass(frozen=True)
class Row:
    """One equation in one column over all seeds.

    `seconds`, `job_seconds` and `point_evaluations` are medians, None when not even half of the searches succeeded.
    """

    system: str
    variable: str
    derivatives: Derivatives
    found: int
    searches: int
    seconds: float | None
    job_seconds: float | None
    point_evaluations: float | None
    paper_seconds: float
    paper_evaluations: float
    expression: str | None

    @property
    def is_found(self) -> bool:
        """Whether the median search found the equation."""
        return self.point_evaluations is not None

    @property
    def is_ahead(self) -> bool:
        """Whether the median search took less time and fewer point evaluations than the paper's."""
        if self.job_seconds is None or self.point_evaluations is None:
            return False
        return self.job_seconds < self.paper_seconds and self.point_evaluations < self.paper_evaluations

    @property
    def seconds_ratio(self) -> float | None:
        """How many times the paper's seconds are ours."""
        return self.paper_seconds / self.job_seconds if self.job_seconds else None

    @property
    def evaluations_ratio(self) -> float | None:
        """How many times the paper's point evaluations are ours."""
        return self.paper_evaluations / self.point_evaluations if self.point_evaluations else None

    @property
    def shown(self) -> str:
        """The equation as a table has it."""
        return clipped(shortened(self.expression or "-", 4), 70)


def with_slopes(system: str, sampled: Sampled) -> Table:
    """Return the table of `sampled` with one more column per state, its exact derivative, and without times."""
    plain = table_of(sampled)
    states = plain.columns[1:]
    slopes = np.array([SYSTEMS[system].field(*state) for state in states.T]).T
    names = (*sampled.names, *(SLOPE + name for name in sampled.names))
    columns = np.ascontiguousarray(np.concatenate((states, slopes)))
    return replace(plain, names=names, units=("",) * len(names), columns=columns)


def configured(options: Namespace, seed: int, equation: tuple[str, str], derivatives: Derivatives) -> JobConfig:
    """Return the configuration of the search for one equation."""
    system, variable = equation
    states = SYSTEMS[system].states
    slopes = tuple(SLOPE + name for name in states) if derivatives == "given" else None
    data = {"states": states, "derivatives": slopes, "only": (variable,)}
    limits = {"max_time": options.max_time, "target_error": options.target_error}
    if options.to_the_end:
        limits |= {"stagnation": jobs.NEVER, "max_epochs": jobs.NEVER}
    return jobs.configured(seed, data, limits, preset=options.preset)


def search(
    searches: Searches, options: Namespace, seed: int, equation: tuple[str, str], derivatives: Derivatives
) -> Verdict:
    """Search one equation once and return the verdict on it."""
    system, variable = equation
    sampled = trajectories(system, STEP, seed)
    measured = with_slopes(system, sampled) if derivatives == "given" else table_of(sampled)
    config = configured(options, seed, equation, derivatives)
    result = searches.solve(f"{system} {variable} seed {seed}", measured, config)
    truths = {variable: TRUTH[system][variable]}
    (verdict,) = judged(Question(f"{system} {derivatives}", seed, truths, prepare(measured, config).dataset), result)
    return verdict


def summed_up(equation: tuple[str, str], derivatives: Derivatives, verdicts: Sequence[Verdict]) -> Row:
    """Return what the searches for one equation came to; `verdicts` has at least one."""
    found = [verdict for verdict in verdicts if verdict.found]
    seconds, evaluations = PAPER[equation]
    return Row(
        *equation,
        derivatives,
        len(found),
        len(verdicts),
        _median([each.search_seconds if each.found else math.inf for each in verdicts]),
        _median([each.seconds if each.found else math.inf for each in verdicts]),
        _median([each.point_evaluations if each.found else math.inf for each in verdicts]),
        seconds,
        evaluations,
        (found or verdicts)[0].expression,
    )


def _median(values: Sequence[float]) -> float | None:
    """Return the median, None when it is infinite."""
    value = statistics.median(values)
    return value if math.isfinite(value) else None


SHOWN: Final = Columns(
    "system | lhs=d{variable}/dt | derivatives | found={found} of {searches} | search s={seconds:.2f} | "
    "job s={job_seconds:.2f} | evaluations={point_evaluations:.2e} | paper s={paper_seconds:.1f} | "
    "paper evaluations={paper_evaluations:.2e} | s ratio={seconds_ratio:.1f} | "
    "evaluations ratio={evaluations_ratio:.0f} | equation={shown}"
)


def balance(rows: Sequence[Row]) -> str:
    """Return sentences on how one column compares with the paper's table."""
    found, ahead = sum(row.is_found for row in rows), sum(row.is_ahead for row in rows)
    ours = sum(row.point_evaluations or 0.0 for row in rows)
    paper = sum(row.paper_evaluations for row in rows if row.is_found)
    lines = [
        f"derivatives {rows[0].derivatives}: {found} of {len(rows)} found in the median, {ahead} ahead of the paper"
    ]
    if found:
        lines.append(f"{ours:.3e} point evaluations for those found; the paper's are {paper / ours:.3g} times as many")
    return "; ".join(lines)


def chosen(options: Namespace) -> list[tuple[str, str]]:
    """Return the equations that the options ask for; raises UsageError when there are none."""
    systems = options.system or TABLE_III
    equations = [
        (system, variable)
        for system, variable in EQUATIONS
        if system in systems and (options.only is None or variable in options.only)
    ]
    if not equations:
        known = ", ".join(name for system in systems for name in TRUTH[system])
        raise UsageError(f"none of the systems has a variable {', '.join(options.only)}; they have {known}")
    return equations


def _searched(
    searches: Searches, options: Namespace, equation: tuple[str, str], derivatives: Derivatives, report: Report
) -> Row:
    """Search one equation with every seed, report each, and return what it came to."""
    verdicts: list[Verdict] = []
    for seed in options.seeds:
        verdicts.append(search(searches, options, seed, equation, derivatives))
        row = summed_up(equation, derivatives, verdicts)
        report.add(verdicts[-1:], rows={f"{' '.join(equation)} {derivatives}": asdict(row)})
    return row


def _show(rows: Sequence[Row], report: Report) -> None:
    say(SHOWN.table(rows))
    missed = [verdict for verdict in report.verdicts if not verdict.found]
    if missed:
        say("\nmissed:\n" + "\n".join(miss(verdict) for verdict in missed))
    for derivatives in COLUMNS:
        column = [row for row in rows if row.derivatives == derivatives]
        if column:
            say("\n" + balance(column))
    say(f"\n{report.summary()}")


@program(
    "benchmarks.paper.table3",
    __doc__,
    option("--system", choices=TABLE_III, action="append", help="repeat for several; default: all seven"),
    option("--only", metavar="VARIABLE", action="append", help="repeat for several; default: both"),
    option(
        "--derivatives", choices=COLUMNS, action="append", help="given exactly, or estimated; default: both, in turn"
    ),
    option("--preset", choices=PRESETS, default="default"),
    option("--target-error", type=positive, help="normalized error at which a search ends"),
    option("--to-the-end", action="store_true", help="use all of --max-time, also without progress"),
    *search_options("0-4", 120.0),
)
def main(options: Namespace) -> int:
    """Search everything, print the table; return 0 when the median search found every equation, else 1."""
    report = Report("table3", options.words, options.out)
    columns = options.derivatives or COLUMNS
    rows: list[Row] = []
    wanted = list(itertools.product(columns, chosen(options)))
    with searching(options.workers) as searches:
        for number, (derivatives, equation) in enumerate(wanted, start=1):
            note(f"{number} of {len(wanted)}: {' '.join(equation)}, derivatives {derivatives}")
            rows.append(_searched(searches, options, equation, derivatives, report))
    _show(rows, report)
    return 0 if all(row.is_found for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
