"""How the job of one table came out: the form of each equation, its verdict, and whether anything of ours broke."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from atoll_core.errors import UsageError
from atoll_core.expression.text.infix import to_infix
from atoll_core.expression.text.parsing import from_infix
from benchmarks.first_hour.cases import Case
from benchmarks.first_hour.tables import Columns
from benchmarks.judging.errors import finite, values_on
from benchmarks.judging.forms import judge_form
from benchmarks.judging.rules import Kind

CONFIDENT: Final = ("exact", "good")
"""Verdicts that tell a reader to rely on an equation."""

CLEAN: Final = 1e-6
"""Of the derivative's size: what an equation may miss on rows without errors where columns determine each other."""

End = Literal["done", "refused", "broke", "late"]


@dataclass(frozen=True)
class EquationOutcome:
    """One equation: what was shown, the law it was to be (None: there is none), its form, and its verdict.

    `miss` is by how much it misses the law on the rows, over that law's root mean square; `is_found`: it is the law.
    """

    state: str
    law: str | None
    expression: str | None
    form: Kind
    miss: float | None
    verdict: str | None
    reason: str | None
    is_found: bool
    is_identified: bool

    @property
    def is_confident(self) -> bool:
        """Whether a reader is told to rely on it."""
        return self.verdict in CONFIDENT

    @property
    def miss_text(self) -> str:
        """What was shown in place of the law."""
        return f"{self.state}' = {self.expression}, not {self.law}"


@dataclass(frozen=True)
class Outcome:
    """One table. ``refused``: with a sentence and exit code 2; ``broke``: code 1, or a warning that something did."""

    case: str
    end: End
    sentence: str
    equations: tuple[EquationOutcome, ...]
    seconds: float
    processor: float
    digest: str | None = None

    @property
    def key(self) -> str:
        """The name of the case."""
        return self.case


def judge(case: Case, result: Mapping[str, Any]) -> tuple[EquationOutcome, ...]:
    """Judge the equations of a result.json, empty where there is none, by the laws of the case."""
    if case.is_long and not result:
        return tuple(_equation(case, state, {}, {}, {}) for state in case.laws)
    columns = (case.clean or case.make)()
    shown = {_plain(case, equation["variable"]): equation for equation in result.get("equations", ())}
    return tuple(
        _equation(case, state, shown.get(state, {}), result.get("symbols", {}), columns) for state in case.laws
    )


def _plain(case: Case, name: str) -> str:
    """Return the plain name of a column of the file."""
    return {_without_unit(given): plain for plain, given in case.header.items()}.get(name, name)


def _without_unit(name: str) -> str:
    for opening in (" [", " ("):
        name = name.partition(opening)[0]
    return name


def _equation(
    case: Case, state: str, equation: Mapping[str, Any], symbols: Mapping[str, str], columns: Columns
) -> EquationOutcome:
    law, text = case.laws[state], equation.get("expression")
    form: Kind = "none"
    miss, is_found = None, False
    if text is not None:
        text = _over_plain_names(case, text, symbols)
        form = "other"
        if law is not None:
            variables = {name: values for name, values in columns.items() if name != "t"}
            miss = _miss(text, law, variables)
            form = judge_form(text, law, variables, with_extra=False).kind
            is_right = form == "right" or (case.is_bound and miss is not None and miss <= CLEAN + 0.1 * _slack(case))
            is_found = is_right and miss is not None and miss <= case.tolerance
    return EquationOutcome(
        state, law, text, form, miss, equation.get("verdict"), equation.get("reason"), is_found,
        case.is_identified and law is not None,
    )  # fmt: skip


def _slack(case: Case) -> float:
    """Return what errors of the columns allow an equation of another form to miss."""
    return 0.0 if case.clean is None else case.tolerance


def _over_plain_names(case: Case, text: str, symbols: Mapping[str, str]) -> str:
    plain = {symbol: _plain(case, _without_unit(column)) for column, symbol in symbols.items()}
    return to_infix(from_infix(text, tuple(plain)), tuple(plain.values()))


def _miss(text: str, law: str, columns: Columns) -> float | None:
    """Return the root mean square difference on the rows over that of the law, None where it is not finite."""
    try:
        one, other = values_on(text, columns), values_on(law, columns)
        with np.errstate(all="ignore"):
            miss = float(np.sqrt(np.mean((one - other) ** 2) / np.mean(other**2)))
    except UsageError:
        return None
    return finite(miss)
