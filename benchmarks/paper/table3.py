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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np

from atoll.terminal.output import clip, error_text, note, say, shorten
from atoll_coordinator.data.prepare import prepare
from atoll_core.config import PRESETS, JobConfig
from atoll_core.data.dataset import FloatArray
from atoll_core.data.table import Table
from atoll_core.errors import UsageError
from benchmarks.harness import jobs
from benchmarks.harness.command_line import option, positive, program, search_options
from benchmarks.harness.record import Record, load
from benchmarks.harness.service import Searches, searching
from benchmarks.harness.systems import SYSTEMS, TABLE_III, TRUTH, Sampled, table_of, trajectories
from benchmarks.harness.tables import Columns, grouped
from benchmarks.judging.forms import compare
from benchmarks.judging.rules import Form, right_ones

STEP: Final = 0.1
"""Sampling step of the paper; with 10 time units, 100 points on a trajectory."""

SLOPE: Final = "slope_of_"
Derivatives = Literal["given", "estimated"]
COLUMNS: Final[tuple[Derivatives, ...]] = ("given", "estimated")

Equation = tuple[str, str]
"""System and variable."""

PAPER: Final[Mapping[Equation, tuple[float, float]]] = {
    ("glider", "v"): (10.2, 1.03e9),
    ("glider", "theta"): (5.1, 0.50e9),
    ("bacterial_respiration", "x"): (75.0, 7.59e9),
    ("bacterial_respiration", "y"): (30.5, 3.09e9),
    ("predator_prey", "x"): (81.7, 8.26e9),
    ("predator_prey", "y"): (290.6, 29.38e9),
    ("bar_magnets", "theta1"): (11.8, 1.19e9),
    ("bar_magnets", "theta2"): (15.6, 1.58e9),
    ("shear_flow", "theta"): (3.6, 0.36e9),
    ("shear_flow", "phi"): (33.9, 3.42e9),
    ("van_der_pol", "x"): (25.5, 2.58e9),
    ("van_der_pol", "y"): (0.9, 0.09e9),
    ("lotka_volterra", "x"): (4.3, 0.43e9),
    ("lotka_volterra", "y"): (1.1, 0.11e9),
}
"""Seconds (8 processors of 2008, one run) and point evaluations of each row of the paper's table."""


@dataclass(frozen=True)
class Search:
    """How one search came out.

    `exact` is what counts. `on_front` is the complexity of the smallest front member that is exact in form, None when
    none is. `error` is normalized by the target's standard deviation.
    """

    system: str
    variable: str
    derivatives: Derivatives
    seed: int
    exact: bool
    reason: str
    expression: str | None
    complexity: int | None
    on_front: int | None
    error: float | None
    why: str | None
    epoch: int
    point_evaluations: int
    search_seconds: float
    seconds: float
    digest: str

    @property
    def equation(self) -> Equation:
        """System and variable."""
        return self.system, self.variable

    @property
    def miss(self) -> str:
        """The sentence on an equation that was not found."""
        front = f"; exact at size {self.on_front} of the front" if self.on_front else ""
        return (
            f"{self.system} {self.variable} {self.derivatives} seed {self.seed}: {self.why or '-'}, {self.epoch} "
            f"epochs, {self.seconds:.1f} s, error {error_text(self.error)}, size {self.complexity}: "
            f"{self.reason}{front}\n    {self.expression}"
        )


@dataclass(frozen=True)
class Row:
    """One equation in one column over all seeds.

    `seconds`, `job_seconds` and `point_evaluations` are medians, None when not even half of the searches succeeded.
    """

    system: str
    variable: str
    derivatives: Derivatives
    right: int
    searches: int
    seconds: float | None
    job_seconds: float | None
    point_evaluations: float | None
    expression: str | None

    @property
    def paper_seconds(self) -> float:
        """The paper's seconds."""
        return PAPER[self.system, self.variable][0]

    @property
    def paper_evaluations(self) -> float:
        """The paper's point evaluations."""
        return PAPER[self.system, self.variable][1]

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
        return clip(shorten(self.expression or "-", 4), 70)


def with_slopes(system: str, sampled: Sampled) -> Table:
    """Return the table of `sampled` with one more column per state, its exact derivative, and without times."""
    plain = table_of(sampled)
    states = plain.columns[1:]
    slopes = np.array([SYSTEMS[system].field(*state) for state in states.T]).T
    names = (*sampled.names, *(SLOPE + name for name in sampled.names))
    columns = np.ascontiguousarray(np.concatenate((states, slopes)))
    return replace(plain, names=names, units=("",) * len(names), columns=columns)


def configured(options: Namespace, seed: int, equation: Equation, derivatives: Derivatives) -> JobConfig:
    """Return the configuration of the search for one equation."""
    system, variable = equation
    states = SYSTEMS[system].states
    slopes = tuple(SLOPE + name for name in states) if derivatives == "given" else None
    data = {"states": states, "derivatives": slopes, "only": (variable,)}
    limits = {"max_time": options.max_time, "target_error": options.target_error}
    return jobs.configured(seed, data, limits, preset=options.preset)


def search(
    searches: Searches, options: Namespace, seed: int, equation: Equation, derivatives: Derivatives
) -> Search:  # fmt: skip
    """Search one equation once and judge it."""
    system, variable = equation
    sampled = trajectories(system, STEP, seed)
    measured = with_slopes(system, sampled) if derivatives == "given" else table_of(sampled)
    config = configured(options, seed, equation, derivatives)
    result = searches.solve(f"{system} {variable} seed {seed}", measured, config)
    dataset = prepare(measured, config).dataset
    return judged(equation, derivatives, seed, result, dict(zip(dataset.names, dataset.inputs, strict=True)))


def judged(
    equation: Equation, derivatives: Derivatives, seed: int, result: Mapping[str, Any],
    columns: Mapping[str, FloatArray],
) -> Search:  # fmt: skip
    """Judge the one equation in `result`, the contents of a result.json, on the rows (R,) that were searched."""
    system, variable = equation

    def rule(expression: str | None) -> Form:
        return compare(expression, TRUTH[system][variable], columns)

    (shown,) = result["equations"]
    form = rule(shown["expression"])
    on_front = min((int(member["complexity"]) for member in right_ones(rule, shown["front"])), default=None)
    return Search(
        *equation,
        derivatives,
        seed,
        form.is_right,
        form.reason,
        shown["expression"],
        shown["complexity"],
        on_front,
        shown["normalized_error"],
        shown["why"],
        shown["epoch"],
        shown["point_evaluations"],
        result["search_seconds"],
        result["seconds"],
        result["digest"],
    )


def summed_up(searched: Sequence[Search]) -> Row:
    """Return what the searches for one equation in one column came to, at least one."""
    right = [search for search in searched if search.exact]
    first = (right or searched)[0]
    return Row(
        *first.equation,
        first.derivatives,
        len(right),
        len(searched),
        _median([search.search_seconds if search.exact else math.inf for search in searched]),
        _median([search.seconds if search.exact else math.inf for search in searched]),
        _median([search.point_evaluations if search.exact else math.inf for search in searched]),
        first.expression,
    )


def _median(values: Sequence[float]) -> float | None:
    """Return the median, None when it is infinite."""
    value = statistics.median(values)
    return value if math.isfinite(value) else None


SHOWN: Final = Columns(
    "system | lhs=d{variable}/dt | derivatives | found={right} of {searches} | search s={seconds:.2f} | "
    "job s={job_seconds:.2f} | evaluations={point_evaluations:.2e} | paper s={paper_seconds:.1f} | "
    "paper evaluations={paper_evaluations:.2e} | s ratio={seconds_ratio:.1f} | "
    "evaluations ratio={evaluations_ratio:.0f} | equation={shown}"
)


def balance(rows: Sequence[Row]) -> str:
    """Return sentences on how one column compares with the paper's table."""
    right, ahead = sum(row.is_found for row in rows), sum(row.is_ahead for row in rows)
    ours = sum(row.point_evaluations or 0.0 for row in rows)
    paper = sum(row.paper_evaluations for row in rows if row.is_found)
    lines = [
        f"derivatives {rows[0].derivatives}: {right} of {len(rows)} found in the median, {ahead} ahead of the paper"
    ]
    if right:
        lines.append(f"{ours:.3e} point evaluations for those found; the paper's are {paper / ours:.3g} times as many")
    return "; ".join(lines)


def chosen(options: Namespace) -> list[Equation]:
    """Return the equations that the options ask for; raises UsageError when there are none."""
    systems = options.system or TABLE_III
    equations = [
        (system, variable)
        for system, variable in PAPER
        if system in systems and (options.only is None or variable in options.only)
    ]
    if not equations:
        known = ", ".join(name for system in systems for name in TRUTH[system])
        raise UsageError(f"none of the systems has a variable {', '.join(options.only)}; they have {known}")
    return equations


def _show(rows: Sequence[Row], searched: Sequence[Search]) -> None:
    say(SHOWN.table(rows))
    missed = [search.miss for search in searched if not search.exact]
    if missed:
        say("\nmissed:\n" + "\n".join(missed))
    for column in grouped(rows, lambda row: row.derivatives).values():
        say("\n" + balance(column))
    seconds = [search.seconds for search in searched]
    times = f"median {statistics.median(seconds):.2f} s, longest {max(seconds):.2f} s"
    say(f"\n{len(searched) - len(missed)} of {len(searched)} exact in form; {times}; load {load():.1f}")


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
    *search_options("0-4", 120.0),
)
def main(options: Namespace) -> int:
    """Search everything, print the table; return 0 when the median search found every equation, else 1."""
    record = Record("table3", options.words, options.out)
    searched: list[Search] = []
    wanted = list(itertools.product(options.derivatives or COLUMNS, chosen(options), options.seeds))
    with searching(options.workers) as searches:
        for number, (derivatives, equation, seed) in enumerate(wanted, start=1):
            searched.append(search(searches, options, seed, equation, derivatives))
            record.add(searched[-1])
            how = "found" if searched[-1].exact else f"missed: {searched[-1].miss}"
            note(f"{number} of {len(wanted)}: {' '.join(equation)} seed {seed}, derivatives {derivatives}: {how}")
    by_row = grouped(searched, lambda search: (search.derivatives, search.equation))
    rows = [summed_up(alike) for alike in by_row.values()]
    _show(rows, searched)
    return 0 if all(row.is_found for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
