"""How one search came out: the error of its coefficients, whether its form is exact, its verdicts.

The error is that of the published table: with coefficient matrices of all monomials, the spectral norm of the
difference over that of the truth. An answer that is no polynomial has none for a polynomial flow.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError
from benchmarks.dysts.flows import Flow
from benchmarks.judging.errors import values_on

_NEGLIGIBLE: Final = 1e-12
SMALL_ERROR: Final = 1e-2
"""A flow that is no polynomial is right when each rate on the test trajectories errs by less than this share of its
standard deviation, and `EXACT_ERROR` without noise."""
EXACT_ERROR: Final = 1e-4

Coefficients = Mapping[tuple[int, ...], float]
"""Coefficients by the exponents of the states."""


@dataclass(frozen=True)
class Outcome:
    """One search: `error` of the coefficients (None: none), whether each equation has the truth's terms (`in_form`).

    `rate_error` is the largest over the states of the error of the rates on the test trajectories, over their standard
    deviation. `seconds` are those of the job, `phases` those of its states.
    """

    system: str
    noise: float
    error: float | None
    in_form: tuple[bool, ...]
    rate_error: float | None
    verdicts: tuple[str | None, ...]
    equations: tuple[str | None, ...]
    seconds: float
    phases: Mapping[str, float]
    failure: str | None = None
    reasons: tuple[str | None, ...] = ()

    @property
    def key(self) -> tuple[str, float]:
        """What was searched: the system, and its noise in percent."""
        return self.system, self.noise

    @property
    def is_exact(self) -> bool:
        """Whether all equations have exactly the truth's terms."""
        return all(self.in_form)

    @property
    def right(self) -> int:
        """How many equations have exactly the truth's terms."""
        return sum(self.in_form)

    @property
    def states(self) -> int:
        """How many equations there are."""
        return len(self.in_form)

    @property
    def verdict_words(self) -> str:
        """The verdicts of all equations."""
        return " ".join(verdict or "-" for verdict in self.verdicts)


def outcome(flow: Flow, noise: float, result: Mapping[str, Any], phases: Mapping[str, float]) -> Outcome:
    """Judge the contents of a result.json."""
    equations = {equation["variable"]: equation for equation in result["equations"]}
    texts = tuple(equations.get(state, {}).get("expression") for state in flow.states)
    answers = [None if text is None else polynomial(text, flow.states) for text in texts]
    truths = [polynomial(text, flow.states) for text in flow.equations]
    rate_error = _rate_error(flow, texts)
    return Outcome(
        flow.name,
        noise,
        coefficient_error(answers, truths),
        tuple(map(_is_in_form, answers, truths)),
        rate_error,
        tuple(equations.get(state, {}).get("verdict") for state in flow.states),
        texts,
        float(result.get("seconds") or 0.0),
        phases,
        result.get("reason"),
        tuple(equations.get(state, {}).get("reason") for state in flow.states),
    )


def polynomial(text: str, states: Sequence[str]) -> Coefficients | None:
    """Return the coefficients of an expression, None where it is no polynomial."""
    import sympy

    if not text:
        return None
    symbols = [sympy.Symbol(state) for state in states]
    try:
        expression = sympy.sympify(text, locals=dict(zip(states, symbols, strict=True)))
        expanded = sympy.expand(expression)
        if not expanded.is_polynomial(*symbols):
            expanded = sympy.cancel(sympy.nsimplify(expanded, rational=True))
        if not expanded.is_polynomial(*symbols):
            return None
        terms = sympy.Poly(expanded, *symbols).terms()
        return {tuple(map(int, powers)): float(value) for powers, value in terms}
    except (sympy.SympifyError, sympy.PolynomialError, TypeError, ValueError, AttributeError):
        return None


def coefficient_error(answers: Sequence[Coefficients | None], truths: Sequence[Coefficients | None]) -> float | None:
    """Return the spectral norm of the difference over that of the truth; None where one is no polynomial."""
    ours = [answer for answer in answers if answer is not None]
    those = [truth for truth in truths if truth is not None]
    if len(ours) < len(answers) or len(those) < len(truths):
        return None
    monomials = sorted({powers for coefficients in (*ours, *those) for powers in coefficients})
    answered, truth = (
        np.array([[coefficients.get(powers, 0.0) for powers in monomials] for coefficients in all_])
        for all_ in (ours, those)
    )
    return float(np.linalg.norm(answered - truth, 2) / np.linalg.norm(truth, 2))


def _is_in_form(answer: Coefficients | None, truth: Coefficients | None) -> bool:
    if answer is None or truth is None:
        return False
    largest = max((abs(value) for value in answer.values()), default=0.0)
    return {powers for powers, value in answer.items() if abs(value) > _NEGLIGIBLE * largest} == set(truth)


def _rate_error(flow: Flow, texts: Sequence[str | None]) -> float | None:
    columns = list(flow.test.reshape(-1, len(flow.states)).T)
    rates = flow.test_rates.reshape(-1, len(flow.states))
    errors = [
        math.inf if text is None else _error(text, flow.states, columns, rates[:, index])
        for index, text in enumerate(texts)
    ]
    worst = max(errors)
    return worst if math.isfinite(worst) else None


def _error(text: str, states: Sequence[str], columns: Sequence[FloatArray], rate: FloatArray) -> float:
    try:
        values = values_on(text, dict(zip(states, columns, strict=True)))
    except UsageError:
        return math.inf
    return float(np.sqrt(np.mean((values - rate) ** 2)) / max(float(rate.std()), 1e-300))
