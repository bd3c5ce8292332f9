"""Tables of what searches on noisy data came to, level by level and equation by equation."""

import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from atoll.terminal.output import clip, error_text, shorten, table
from benchmarks.harness import tables
from benchmarks.harness.tables import Columns, grouped, median, percent
from benchmarks.noise.data import Key
from benchmarks.noise.judging import BY_FUNCTION, EquationOutcome, Outcome


@dataclass(frozen=True)
class Summary:
    """What the searches of one kind came to: one method and level of noise.

    Counts are medians over seeds, of `equations` each. `elsewhere` is how many equations over all seeds were not shown
    in the true form although it was among the contenders or on the front. Errors are medians over all equations found,
    of the largest error of a constant without those judged by their function. `intervals` counts the constants with an
    interval, `covered` those of them whose interval holds the truth.
    """

    method: str
    level: float
    seeds: int
    equations: float
    found: float
    in_form: float
    foretold: float
    elsewhere: int
    constants_error: float | None
    function_error: float | None
    intervals: int
    covered: int
    relative_width: float | None
    seconds: float
    longest_s: float

    @property
    def coverage(self) -> float | None:
        """Share of the intervals that hold the truth."""
        return self.covered / self.intervals if self.intervals else None


def summarized(outcomes: Sequence[Outcome]) -> list[Summary]:
    """Return a summary for each level and method, by rising level."""
    kinds = grouped(outcomes, lambda outcome: (outcome.key.level, outcome.key.method))
    return [_summary(searched) for _, searched in sorted(kinds.items(), key=lambda item: item[0][0])]


def _summary(outcomes: Sequence[Outcome]) -> Summary:
    key = outcomes[0].key
    equations = [(outcome.key.system, equation) for outcome in outcomes for equation in outcome.equations]
    fair = [equation for system, equation in equations if equation.in_form and system not in BY_FUNCTION]
    intervals = [constant for equation in fair for constant in equation.constants or () if constant.has_interval]
    function_errors = [equation.function_error for _, equation in equations]
    return Summary(
        method=key.method,
        level=key.level,
        seeds=len({outcome.key.seed for outcome in outcomes}),
        equations=_by_seed(outcomes, lambda equation: True),
        found=_by_seed(outcomes, lambda equation: equation.found),
        in_form=_by_seed(outcomes, lambda equation: equation.in_form),
        foretold=_by_seed(outcomes, lambda equation: equation.is_foretold),
        elsewhere=sum(equation.elsewhere is not None for _, equation in equations),
        constants_error=_known_median(equation.constants_error for equation in fair),
        function_error=_known_median(function_errors),
        intervals=len(intervals),
        covered=sum(constant.is_covered for constant in intervals),
        relative_width=_known_median(constant.relative_width for constant in intervals),
        seconds=statistics.median(outcome.seconds for outcome in outcomes),
        longest_s=max(outcome.seconds for outcome in outcomes),
    )


def _by_seed(outcomes: Sequence[Outcome], counts: Callable[[EquationOutcome], bool]) -> float:
    """Return the median over seeds of the number of equations that count."""
    by_seed = grouped(outcomes, lambda outcome: outcome.key.seed).values()
    return statistics.median(
        sum(counts(equation) for outcome in searched for equation in outcome.equations) for searched in by_seed
    )


def _known_median(values: Iterable[float | None]) -> float | None:
    return median([value for value in values if value is not None])


LEVELS: Final = Columns(
    "noise={level:g} | method | seeds | found={found:g} of {equations:g} | in form={in_form:g} | elsewhere | "
    "foretold={foretold:g} | constants={constants_error:percent} | function={function_error:percent} | intervals | "
    "covered={coverage:percent} | width={relative_width:percent} | job s={seconds:.1f} | longest s={longest_s:.1f}"
)


def by_level(summaries: Sequence[Summary]) -> str:
    """Return a table with a row for each summary."""
    return LEVELS.table(summaries)


def by_equation(outcomes: Sequence[Outcome]) -> str:
    """Return a table with a row for each equation, and in how many searches it was found at each level."""
    levels = sorted({outcome.key.level for outcome in outcomes})
    searched = [(outcome.key, equation) for outcome in outcomes for equation in outcome.equations]
    rows = []
    for name, equations in grouped(searched, _method_and_equation).items():
        shares = [_share([equation for key, equation in equations if key.level == level]) for level in levels]
        rows.append((*name, *shares))
    return table(("method", "equation", *(f"noise {level:g}" for level in levels)), rows)


def _method_and_equation(searched: tuple[Key, EquationOutcome]) -> tuple[str, str]:
    key, equation = searched
    return key.method, f"{key.system} {equation.variable}"


def _share(equations: Sequence[EquationOutcome]) -> str:
    if not equations:
        return "-"
    right = sum(equation.found for equation in equations)
    foretold = sum(equation.is_foretold for equation in equations)
    error = _known_median(equation.constants_error for equation in equations if equation.found)
    return f"{right}/{len(equations)}, R² {foretold}/{len(equations)}, {percent(error)}"


def by_grade(outcomes: Sequence[Outcome]) -> str:
    """Return a table that sets the verdicts of the results beside what is true."""
    rows = []
    equations = [equation for outcome in outcomes for equation in outcome.equations]
    for grade, graded in tables.by_grade(equations, lambda equation: equation.grade).items():
        right = sum(equation.found for equation in graded)
        foretold = sum(equation.is_foretold for equation in graded)
        rows.append((grade, str(len(graded)), str(right), str(foretold)))
    return table(("verdict", "equations", "found", "foretold"), rows)


def misses(outcomes: Sequence[Outcome]) -> list[str]:
    """Return a sentence for each equation that was not found."""
    return [
        f"{outcome.key.method}: {outcome.key.title} {equation.variable}: {miss(equation)}"
        for outcome in outcomes
        for equation in outcome.equations
        if not equation.found
    ]


def miss(equation: EquationOutcome) -> str:
    """Return what was found instead of the truth, and why it does not count."""
    elsewhere = f"; the truth is among the {equation.elsewhere}" if equation.elsewhere else ""
    grade = f"; verdict {equation.grade}: {equation.grade_reason}" if equation.grade else ""
    text = clip(shorten(equation.expression or "-", 4), 90)
    function = error_text(equation.function_error)
    return f"{equation.reason}{elsewhere}, function error {function}, R² {_two(equation.r2)}{grade}: {text}"


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
