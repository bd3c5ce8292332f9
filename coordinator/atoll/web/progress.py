"""What pages draw of a result, also of the best so far: equations, fronts, convergence. Pure, of bounded size."""

from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any, Final

import numpy as np

from atoll.display.notation import equation_mathml
from atoll.model.equations import r2_text, rounded
from atoll.text.conclusion import conclusion
from atoll.text.render import constants_line
from atoll_coordinator.result.equations import Candidate, Convergence, Equation, Member
from atoll_coordinator.result.result import Result
from atoll_core.errors import AtollError

MAX_POINTS: Final = 2_000
"""Points of all curves of a job together: more than a screen is wide."""

MAX_CURVES: Final = 32
"""Islands that are drawn one by one; of more of them the best, the median and the worst are drawn."""


def progress(result: Result) -> dict[str, Any]:
    """Return how far a job has come, by equation, as plain data."""
    points = MAX_POINTS // max(1, len(result.equations))
    return {
        "job": result.job,
        "config": result.config,
        "files": list(result.data.files) if result.data is not None else [],
        "conclusion": conclusion(result),
        "warnings": list(result.proper_warnings),
        "notes": list(result.notes),
        "equations": [_equation(equation, result.names, points) for equation in result.equations],
    }


def _equation(equation: Equation, names: Sequence[str], points: int) -> dict[str, Any]:
    curves = _curves(equation.convergence, points)
    constants = constants_line(equation.constants)
    return {
        "variable": equation.variable,
        "lhs": equation.lhs,
        "expression": _text(equation.expression, names),
        "mathml": _mathml(equation, equation.expression, names),
        "constants": constants.removeprefix("constants: ") if constants else None,
        "origin": equation.origin,
        "candidates": [_candidate(candidate, names) for candidate in equation.candidates],
        "verdict": equation.verdict,
        "reason": equation.reason,
        "checks": [check.model_dump(include={"name", "outcome", "reason"}) for check in equation.checks],
        "front": [_member(member, equation, names) for member in equation.front],
        "convergence": curves,
        "plateau": _plateau(equation.convergence),
    }


def _member(member: Member, equation: Equation, names: Sequence[str]) -> dict[str, Any]:
    return {
        "complexity": member.complexity,
        "error": member.error,
        "normalized_error": member.normalized_error,
        "expression": _text(member.expression, names),
        "selected": member.selected,
        "mathml": _mathml(equation, member.expression, names),
    }


def _candidate(candidate: Candidate, names: Sequence[str]) -> dict[str, Any]:
    return {
        "expression": _text(candidate.expression, names),
        "nats": candidate.nats,
        "r2": r2_text(candidate.r2),
        "held_out_r2": None if candidate.held_out_r2 is None else r2_text(candidate.held_out_r2),
        "complexity": candidate.complexity,
        "origin": candidate.origin,
        "selected": candidate.selected,
    }


def _text(expression: str | None, names: Sequence[str]) -> str | None:
    """Return an expression with as many digits as the terminal shows."""
    return None if expression is None else _round(expression, tuple(names))


@lru_cache(4_096)
def _round(expression: str, names: tuple[str, ...]) -> str:
    try:
        return rounded(expression, names)
    except AtollError:
        return expression


def _mathml(equation: Equation, expression: str | None, names: Sequence[str]) -> str | None:
    return None if expression is None else _typeset(equation.lhs, equation.variable, expression, tuple(names))


@lru_cache(4_096)
def _typeset(lhs: str, variable: str, expression: str, names: tuple[str, ...]) -> str | None:
    try:
        return equation_mathml(lhs, variable, expression, names)
    except AtollError:  # shown as text then
        return None


def _plateau(curves: Sequence[Convergence]) -> int | None:
    """Return the generation in which any island last got better."""
    return max((curve.generations[-1] for curve in curves), default=None)


def _curves(curves: Sequence[Convergence], points: int) -> list[dict[str, Any]]:
    if len(curves) <= MAX_CURVES:
        each = max(2, points // max(1, len(curves)))
        return [_curve(curve.island, curve.generations, curve.errors, each) for curve in curves]
    generations = np.unique(np.concatenate([curve.generations for curve in curves]))
    generations = generations[some(len(generations), points // 3)]
    errors = np.stack([_at(generations, curve) for curve in curves])
    with np.errstate(all="ignore"):
        bands = {"best": errors.min(0), "median": np.median(errors, 0), "worst": errors.max(0)}
    return [_curve(name, generations, band, len(generations)) for name, band in bands.items()]


def _at(generations: np.ndarray[Any, Any], curve: Convergence) -> np.ndarray[Any, Any]:
    """Return the error of an island in these generations: that of its last improvement."""
    places = np.searchsorted(curve.generations, generations, "right") - 1
    errors = np.asarray(curve.errors, dtype=float)[np.maximum(places, 0)]
    return np.where(places < 0, np.inf, errors)


def _curve(name: int | str, generations: Iterable[Any], errors: Iterable[Any], points: int) -> dict[str, Any]:
    times, values = list(generations), list(errors)
    kept = some(len(times), points)
    return {
        "island": name,
        "generations": [int(times[place]) for place in kept],
        "errors": [_number(values[place]) for place in kept],
    }


def _number(value: Any) -> float | None:
    return float(f"{value:.4g}") if value is not None and np.isfinite(value) else None


def some(number: int, most: int) -> list[int]:
    """Return at most so many places of a sequence, the first and the last among them."""
    if number <= most:
        return list(range(number))
    return [int(place) for place in np.unique(np.linspace(0, number - 1, max(2, most)).round())]
