"""How one job came out: the form of each equation, whether it predicts, its verdict, and whether that is false.

"Exact" is false where the form is not the law's; "good" where the form is not the law's and the state is not predicted
from other initial states (R² at most 0.9), which is what it promises (ADR 0037). Where there is no law both are false.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

from atoll_core.errors import AtollError, UsageError
from benchmarks.first_hour.outcomes import CONFIDENT
from benchmarks.harness.tables import GRADES
from benchmarks.judging.coverage import Covered, covered
from benchmarks.judging.errors import values_on
from benchmarks.judging.forms import judge_form
from benchmarks.judging.generalisation import is_foretold
from benchmarks.judging.rules import Kind
from benchmarks.verdicts.drawn import Drawn, Predictions
from benchmarks.verdicts.identification import DECIDED

End = Literal["done", "refused", "broke", "late"]

NO_MODEL: Final = "no model"


@dataclass(frozen=True, order=True)
class Key:
    """Which job: the campaign, the seed of the table, and the variant of it or of the options."""

    campaign: str
    seed: int
    variant: str = ""

    @property
    def title(self) -> str:
        """The key as people read it."""
        return f"{self.campaign} {self.seed}" + (f" {self.variant}" if self.variant else "")


@dataclass(frozen=True)
class EquationOutcome:
    """One equation: the law (None: there is none), what was shown, its form, R² from other states, and its verdict.

    `r2` is -inf where the model cannot be simulated, None where there is nothing to judge by; `beyond` is R² beyond
    what was measured. `is_identified`: the data tell the law from shorter ones; `lead`: by how many nats a right one
    describes them better than other textbook forms, None where that is not known. `covered` of the `intervals` (95 %)
    of the constants of a right equation hold the truth.
    """

    variable: str
    law: str | None
    expression: str | None
    form: Kind
    r2: float | None
    grade: str
    reason: str | None
    is_identified: bool
    t: float | None = None
    beyond: float | None = None
    covered: int = 0
    intervals: int = 0
    lead: float | None = None

    @property
    def is_decided(self) -> bool:
        """Whether it is identified, and the data tell its law from other textbook forms as far as that is known."""
        return self.is_identified and (self.lead is None or self.lead >= DECIDED)

    @property
    def is_right(self) -> bool:
        """Whether it has the form of the law, and nothing else."""
        return self.form == "right"

    @property
    def is_predicted(self) -> bool:
        """Whether it predicts from other initial states."""
        return is_foretold(self.r2)

    @property
    def is_wrong_beyond(self) -> bool:
        """Whether it is relied on, has another form, predicts from other initial states, but not beyond."""
        is_wrong = self.grade in CONFIDENT and not self.is_right and not self.is_false
        return is_wrong and self.beyond is not None and not is_foretold(self.beyond)

    @property
    def is_false(self) -> bool:
        """Whether the verdict says more than is true."""
        if self.grade not in CONFIDENT or self.is_right:
            return False
        is_open = self.law is not None and self.r2 is None
        return self.grade == "exact" or not (self.is_predicted or is_open)


@dataclass(frozen=True)
class Outcome:
    """One job. ``refused``: the data or options were, with a sentence; ``late``: it was cancelled.

    `limit` is its --max-time, None without; `is_cut`: that ended the search or the choice of equations. `numbers`
    counts fitted constants and initial values, `values` the measured values of the states or the target.
    """

    key: Key
    kind: str
    rows: int
    end: End
    sentence: str
    equations: tuple[EquationOutcome, ...]
    seconds: float
    limit: float | None = None
    is_cut: bool = False
    digest: str | None = None
    numbers: int = 0
    values: int = 0

    @property
    def is_saturated(self) -> bool:
        """Whether the model has as many fitted numbers as the table has values."""
        return self.numbers >= self.values > 0


def judge(drawn: Drawn, result: Mapping[str, Any]) -> tuple[EquationOutcome, ...]:
    """Judge the equations of a result.json, empty where there is none."""
    shown = {equation["variable"]: equation for equation in result.get("equations", ())}
    models = {group: _model(shown, laws, group) for group, laws in drawn.laws.items()}
    r2: Predictions = {} if drawn.predict is None or not shown else drawn.predict(models)
    return tuple(_equation(drawn, variable, shown.get(variable, {}), models, r2) for variable in _judged(drawn))


def numbers_of(drawn: Drawn, result: Mapping[str, Any]) -> int:
    """Return how many numbers were fitted: constants, those of each group, and initial values; 0 without a model."""
    equations = [equation for equation in result.get("equations", ()) if equation.get("expression") is not None]
    states = len(equations) * (2 if "--order" in drawn.words else 1)
    return sum(map(_constants, equations)) + states * drawn.runs if equations else 0


def _constants(equation: Mapping[str, Any]) -> int:
    groups = equation.get("groups") or ()
    if not groups:
        return len(equation.get("constants") or ())
    lists = [group.get("constants") or () for group in groups]
    shared = sum(bool(constant.get("shared")) for constant in lists[0])
    return shared + sum(not constant.get("shared") for constants in lists for constant in constants)


def values_of(drawn: Drawn) -> int:
    """Return how many values of states, or of the target, the table has."""
    return drawn.rows * len(_judged(drawn))


def _judged(drawn: Drawn) -> tuple[str, ...]:
    return tuple(next(iter(drawn.laws.values())))


def _model(shown: Mapping[str, Any], laws: Mapping[str, Any], group: str) -> dict[str, str | None]:
    """Return the equations of a group, those of the laws first."""
    variables = dict.fromkeys((*laws, *shown))
    return {variable: _of_group(shown.get(variable, {}), group).get("expression") for variable in variables}


def _of_group(equation: Mapping[str, Any], group: str) -> Mapping[str, Any]:
    """Return the equation of a group, the common one where it has none of its own."""
    groups: dict[str, Mapping[str, Any]] = {one["group"]: one for one in equation.get("groups") or ()}
    if groups and group and group not in groups:
        raise AtollError(f"the result has no group {group!r}, but {', '.join(groups)}; the table was read differently")
    return groups.get(group, equation)


def _equation(
    drawn: Drawn, variable: str, equation: Mapping[str, Any], models: Mapping[str, Mapping[str, str | None]],
    r2: Predictions,
) -> EquationOutcome:  # fmt: skip
    laws = {group: laws[variable] for group, laws in drawn.laws.items()}
    forms = [_form(drawn, models[group][variable], law) for group, law in laws.items()]
    near, far = r2.get(variable, (None, None))
    t = drawn.t.get(variable)
    form: Kind = next((form for form in forms if form != "right"), "right")
    intervals = [one for group, law in laws.items() for one in _intervals(drawn, _of_group(equation, group), form, law)]
    is_identified = None not in laws.values() and drawn.is_identified(variable)
    leads = drawn.leads if is_identified and form == "right" else None  # it takes seconds, and nothing else asks for it
    return EquationOutcome(
        variable, next(iter(laws.values())), equation.get("expression"),
        form, _known(near),
        equation.get("verdict") or NO_MODEL, equation.get("reason"),
        is_identified, t,
        _known(far), sum(one.is_covered for one in intervals), len(intervals),
        None if leads is None else leads.get(variable),
    )  # fmt: skip


def _intervals(drawn: Drawn, equation: Mapping[str, Any], form: Kind, law: str | None) -> list[Covered]:
    """Return the constants of an equation of the right form that have an interval, beside their true values."""
    if form != "right" or law is None:
        return []
    try:
        constants = covered(
            equation["expression"], equation.get("constants") or (), drawn.clean, values_on(law, drawn.clean)
        )
    except UsageError:  # too long to be read back with constants that are all different
        return []
    return [constant for constant in constants or () if constant.has_interval]


def _known(value: float | None) -> float | None:
    return None if value is None or math.isnan(value) else value


def _form(drawn: Drawn, text: str | None, law: str | None) -> Kind:
    if text is None:
        return "none"
    if law is None:
        return "other"
    try:
        return judge_form(text, law, drawn.clean, with_extra=True).kind
    except UsageError:
        return "other"


def rank(grade: str) -> int:
    """Return the place of a verdict, the best first."""
    return GRADES.index(grade) if grade in GRADES else len(GRADES)


def is_same_model(one: EquationOutcome, other: EquationOutcome, drawn: Drawn) -> bool:
    """Tell whether two equations have one form: constants of either make it equal to the other."""
    if one.expression is None or other.expression is None:
        return one.expression == other.expression
    if one.expression == other.expression or (one.is_right and other.is_right):
        return True
    try:
        return judge_form(one.expression, other.expression, drawn.clean or drawn.columns, with_extra=False).is_right
    except UsageError:
        return False
