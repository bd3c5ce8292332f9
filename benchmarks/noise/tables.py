"""Tables of what searches on noisy data came to, level by level and equation by equation."""

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from atoll.terminal.output import clipped, error_text, shortened, table
from benchmarks.harness import tables
from benchmarks.harness.tables import Columns, grouped, median, percent
from benchmarks.noise.judging import BY_FUNCTION, EquationOutcome, Outcome


@dataclass(frozen=True)
class Summary:
    """What the searches of one kind came to: one method, manner of sampling and level of noise.

    Counts are medians over seeds, of `equations` each, `least_found` and `least_foretold` minima over seeds.
    `elsewhere` is how many equations over all seeds were not shown
    in the true form although it was among the contenders or on the front. Errors are over all equations found, those
    judged by their function apart: the median of the largest error of a constant, and the value below which 90 % lie.
    `intervals` counts the constants with an interval, `covered` those of them whose interval holds the truth, `without`
    the constants that have none, `unmatched` the found equations whose constants have no known truth.
    """

    method: str
    variant: str
    level: float
    seeds: int
    equations: float
    found: float
    in_form: float
    foretold: float
    least_found: float
    least_foretold: float
    elsewhere: int
    constants_error: float | None
    constants_error_90: float | None
    own_error: float | None
    function_error: float | None
    intervals: int
    covered: int
    without: int
    unmatched: int
    relative_width: float | None
    seconds: float
    longest_s: float
    refining_s: float | None

    @property
    def coverage(self) -> float | None:
        """Share of the intervals that hold the truth."""
        return self.covered / self.intervals if self.intervals else None


def summarized(outcomes: Sequence[Outcome]) -> list[Summary]:
    """Return a summary for each level, manner of sampling and method, by rising level."""
    kinds = grouped(outcomes, lambda outcome: (outcome.key.level, outcome.key.variant, outcome.key.method))
    return [_summary(searched) for _, searched in sorted(kinds.items(), key=lambda item: item[0][0])]


def _summary(outcomes: Sequence[Outcome]) -> Summary:
    key = outcomes[0].key
    equations = [(outcome.key.system, equation) for outcome in outcomes for equation in outcome.equations]
    fair = [its for system, its in equations if its.in_form and system not in BY_FUNCTION]
    constants = [constant for its in fair for constant in its.constants or ()]
    errors = [its.constants_error for its in fair if its.constants_error is not None]
    with_interval = [constant for constant in constants if constant.has_interval]
    widths = [constant.relative_width for constant in with_interval if constant.relative_width is not None]
    refining = [each.phases["refining"] for each in outcomes if "refining" in each.phases]
    return Summary(
        method=key.method,
        variant=key.variant,
        level=key.level,
        seeds=len({each.key.seed for each in outcomes}),
        equations=_by_seed(outcomes, lambda its: True),
        found=_by_seed(outcomes, lambda its: its.found),
        in_form=_by_seed(outcomes, lambda its: its.in_form),
        foretold=_by_seed(outcomes, lambda its: its.is_foretold),
        least_found=min(_counts(outcomes, lambda its: its.found)),
        least_foretold=min(_counts(outcomes, lambda its: its.is_foretold)),
        elsewhere=sum(its.elsewhere is not None for _, its in equations),
        constants_error=median(errors),
        constants_error_90=float(np.quantile(errors, 0.9)) if errors else None,
        own_error=median([its.own_error for its in fair if its.own_error is not None]),
        function_error=median([its.function_error for _, its in equations if its.function_error is not None]),
        intervals=len(with_interval),
        covered=sum(constant.is_covered for constant in with_interval),
        without=len(constants) - len(with_interval),
        unmatched=sum(its.constants is None for its in fair),
        relative_width=median(widths),
        seconds=statistics.median(each.seconds for each in outcomes),
        longest_s=max(each.seconds for each in outcomes),
        refining_s=median(refining),
    )


def _by_seed(outcomes: Sequence[Outcome], counts: Callable[[EquationOutcome], bool]) -> float:
    """Return the median over seeds of the number of equations that count."""
    return statistics.median(_counts(outcomes, counts))


def _counts(outcomes: Sequence[Outcome], counts: Callable[[EquationOutcome], bool]) -> list[int]:
    """Return for each seed the number of equations that count."""
    by_seed = grouped(outcomes, lambda outcome: outcome.key.seed).values()
    return [sum(counts(equation) for each in searched for equation in each.equations) for searched in by_seed]


LEVELS: Final = Columns(
    "noise={level:g} | sampling={variant} | method | seeds | found={found:g} of {equations:g} | in form={in_form:g} | "
    "elsewhere | foretold={foretold:g} | constants={constants_error:percent} | 90 %={constants_error_90:percent} | "
    "own={own_error:percent} | function={function_error:percent} | intervals | covered={coverage:percent} | without | "
    "unmatched | width={relative_width:percent} | job s={seconds:.1f} | longest s={longest_s:.1f}"
)


def by_level(summaries: Sequence[Summary]) -> str:
    """Return a table with a row for each summary."""
    return LEVELS.table(summaries)


def by_equation(outcomes: Sequence[Outcome]) -> str:
    """Return a table with a row for each equation, and in how many searches it was found at each level."""
    kinds = grouped(outcomes, lambda outcome: (outcome.key.method, outcome.key.variant))
    levels = sorted({each.key.level for each in outcomes})
    rows = []
    for (method, variant), chosen in kinds.items():
        names = dict.fromkeys((each.key.system, equation.variable) for each in chosen for equation in each.equations)
        for system, name in names:
            cells = [_share(chosen, system, name, level) for level in levels]
            rows.append((method, variant, f"{system} {name}", *cells))
    return table(("method", "sampling", "equation", *(f"noise {level:g}" for level in levels)), rows)


def _share(outcomes: Sequence[Outcome], system: str, name: str, level: float) -> str:
    its = [
        equation
        for outcome in outcomes
        if (outcome.key.system, outcome.key.level) == (system, level)
        for equation in outcome.equations
        if equation.variable == name
    ]
    if not its:
        return "-"
    found, foretold = sum(each.found for each in its), sum(each.is_foretold for each in its)
    error = median([each.constants_error for each in its if each.found and each.constants_error is not None])
    return f"{found}/{len(its)}, R² {foretold}/{len(its)}, {percent(error)}"


def by_grade(outcomes: Sequence[Outcome]) -> str:
    """Return a table that sets the verdicts of the results beside what is true."""
    rows = []
    equations = [equation for outcome in outcomes for equation in outcome.equations]
    for grade, graded in tables.by_grade(equations).items():
        found, foretold = sum(each.found for each in graded), sum(each.is_foretold for each in graded)
        rows.append((grade, str(len(graded)), str(found), str(foretold)))
    return table(("verdict", "equations", "found", "foretold"), rows)


def misses(outcomes: Sequence[Outcome]) -> list[str]:
    """Return a sentence for each equation that was not found."""
    return [
        f"{outcome.key.method}: {outcome.key.title} {equation.variable}: {miss(equation)}"
        for outcome in outcomes
        for equation in outcome.equations
        if not equation.found
    ]


def miss(its: EquationOutcome) -> str:
    """Return what was found instead of the truth, and why it does not count."""
    elsewhere = f"; the truth is among the {its.elsewhere}" if its.elsewhere else ""
    grade = f"; verdict {its.grade}: {its.grade_reason}" if its.grade else ""
    text = clipped(shortened(its.expression or "-", 4), 90)
    function = error_text(its.function_error)
    return f"{its.reason}{elsewhere}, function error {function}, R² {_two(its.r2)}{grade}: {text}"


def line(outcome: Outcome) -> str:
    """Return how one search came out, for following a long run."""
    marks = ", ".join(
        f"{equation.variable} {'found' if equation.found else 'MISSED'} R² {_two(equation.r2)}"
        for equation in outcome.equations
    )
    phases = " + ".join(f"{name} {seconds:.1f}" for name, seconds in outcome.phases.items())
    return f"{outcome.key.method}: {outcome.key.title}: {marks}; {outcome.seconds:.1f} s ({phases or '-'})"


def _two(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
