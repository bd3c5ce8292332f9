"""Data for charts of a result, of bounded size: equations, fronts, convergence, simulated curves. Pure functions."""

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any, Final

import numpy as np

from atoll.api.model import Model
from atoll.display.curves import choose_trajectories, curves_of, label
from atoll.display.notation import equation_mathml
from atoll.model.arguments import initial_conditions
from atoll.model.equations import GivenWords, given_words, r2_text, rounded, side_text
from atoll.model.simulation import SimulationResult
from atoll.text.conclusion import conclusion
from atoll.text.render import constants_line, given_lines, run_lines
from atoll_coordinator.result.base import Number
from atoll_coordinator.result.equations import Convergence, Equation
from atoll_coordinator.result.listed_trajectories import Simulated
from atoll_coordinator.result.result import Result
from atoll_core.errors import AtollError

MAX_POINTS: Final = 2_000
"""Maximum number of points of all convergence curves of a job together: more than the pixels of a screen's width."""

MAX_CURVES: Final = 32
"""Maximum number of islands with a curve each; with more, only the best, the median and the worst have curves."""

MOST_ROWS: Final = 1_000
"""Maximum number of rows of a column, and of measured points of a picture."""


def some(number: int, most: int) -> list[int]:
    """Return at most `most` indices of a sequence, including the first and the last."""
    if number <= most:
        return list(range(number))
    return [int(index) for index in np.unique(np.linspace(0, number - 1, max(2, most)).round())]


def _numbers(values: Iterable[Number], digits: int = 6) -> list[float | None]:
    return [float(f"{value:.{digits}g}") if value is not None and math.isfinite(value) else None for value in values]


# ----------------------------------------------------------------------------------------------------------- progress


def progress(result: Result) -> dict[str, Any]:
    """Return the progress of a job by equation, as plain data."""
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
    symbols, given = tuple(names), given_words(equation, names)
    constants = constants_line(given.constants)

    def written(expression: str | None) -> dict[str, Any]:
        if expression is None:
            return {"expression": None, "mathml": None}
        typeset = _mathml(equation.lhs, equation.variable, expression, symbols)
        return {"expression": _rounded(expression, symbols), "mathml": typeset}

    return {
        "variable": equation.variable,
        "lhs": equation.lhs,
        **written(equation.expression),
        **(_given_side(equation, symbols, given) if given.text else {}),
        **(_values_by_run(equation) if equation.runs else {}),
        "constants": constants.removeprefix("constants: ") if constants else None,
        "origin": equation.origin,
        "candidates": [
            {
                "expression": _rounded(candidate.expression, symbols, is_given=bool(given.text)),
                "nats": candidate.nats,
                "r2": r2_text(candidate.r2),
                "held_out_r2": None if candidate.held_out_r2 is None else r2_text(candidate.held_out_r2),
                "complexity": candidate.complexity,
                "origin": candidate.origin,
                "selected": candidate.selected,
            }
            for candidate in equation.candidates
        ],
        "verdict": equation.verdict,
        "reason": equation.reason,
        "checks": [check.model_dump(include={"name", "outcome", "reason"}) for check in equation.checks],
        "front": [
            {
                "complexity": member.complexity,
                "error": member.error,
                "normalized_error": member.normalized_error,
                **written(member.expression),
                "selected": member.selected,
            }
            for member in equation.front
        ],
        "convergence": _convergence_curves(equation.convergence, points),
        "plateau": max((curve.generations[-1] for curve in equation.convergence), default=None),
    }


def _given_side(equation: Equation, names: tuple[str, ...], given: GivenWords) -> dict[str, Any]:
    """Return a side with its parameters by name, and lines with the user's text and the values."""
    typeset = equation_mathml(equation, names)
    return {"expression": side_text(equation, names), "mathml": typeset, "given": given_lines(given)}


def _values_by_run(equation: Equation) -> dict[str, Any]:
    """Return a parameter that differs by run, with a line for each value."""
    values = ", ".join(f"{one.estimate:.4g}" for one in equation.runs)
    return {"lhs": equation.variable, "expression": f"{values} by run", "mathml": None, "given": run_lines(equation)}


@lru_cache(4_096)
def _rounded(expression: str, names: tuple[str, ...], *, is_given: bool = False) -> str:
    try:
        return rounded(expression, names, is_given=is_given)
    except AtollError:
        return expression


@lru_cache(4_096)
def _mathml(lhs: str, variable: str, expression: str, names: tuple[str, ...]) -> str | None:
    try:
        return equation_mathml(Equation(variable=variable, lhs=lhs, expression=expression), names)
    except AtollError:  # shown as text then
        return None


def _convergence_curves(curves: Sequence[Convergence], points: int) -> list[dict[str, Any]]:
    if len(curves) <= MAX_CURVES:
        each = max(2, points // max(1, len(curves)))
        return [_convergence(curve.island, curve.generations, curve.errors, each) for curve in curves]
    generations = np.unique(np.concatenate([curve.generations for curve in curves]))
    generations = generations[some(len(generations), points // 3)]
    errors = np.stack([_errors_at(generations, curve) for curve in curves])
    with np.errstate(all="ignore"):
        bands = {"best": errors.min(0), "median": np.median(errors, 0), "worst": errors.max(0)}
    return [_convergence(name, generations, band, len(generations)) for name, band in bands.items()]


def _errors_at(generations: np.ndarray[Any, Any], curve: Convergence) -> np.ndarray[Any, Any]:
    """Return the error of an island in each of `generations`: the error of its last improvement until then."""
    indices = np.searchsorted(curve.generations, generations, "right") - 1
    errors = np.asarray(curve.errors, dtype=float)[np.maximum(indices, 0)]
    return np.where(indices < 0, np.inf, errors)


def _convergence(name: int | str, generations: Iterable[Any], errors: Iterable[Any], points: int) -> dict[str, Any]:
    times, values = list(generations), list(errors)
    kept = some(len(times), points)
    return {
        "island": name,
        "generations": [int(times[index]) for index in kept],
        "errors": _numbers((values[index] for index in kept), 4),
    }


# --------------------------------------------------------------------------------------------------------- simulation


def simulation_of(result: Result) -> dict[str, Any]:
    """Return a simulation as columns, and simulated and measured curves of each trajectory.

    A regression has fitted values instead; a result without a model has only a message.
    """
    answer: dict[str, Any] = {"time": result.time, "columns": {}, "trajectories": [], "fitted": None, "message": ""}
    try:
        model = Model(result)
        if model.is_regression:
            return answer | {"fitted": _fitted_values(model)}
        parts = choose_trajectories(result.simulated)
        simulation = None if model.groups else model.simulate(has_bands=False)
        if not parts and simulation is not None:
            parts = [_simulated(model, simulation)]
    except AtollError as error:
        return answer | {"message": str(error)}
    labels = {name: label(result, name) for name in (result.time, *result.columns.states)}
    answer |= {"labels": labels, "trajectories": [_trajectory(model, part) for part in parts]}
    answer["trajectories_in_total"] = max(len(parts), len(result.simulated))
    if simulation is not None:
        rows = some(len(simulation.t), MOST_ROWS)
        columns = {name: _numbers(values[rows].tolist()) for name, values in simulation.columns().items()}
        answer |= {"columns": columns, "message": simulation.message}
    return answer


def _simulated(model: Model, simulation: SimulationResult) -> Simulated:
    """Return the simulation of a picked equation from the first measured state, in the form of a result."""
    beginning, names = initial_conditions(model), model.result.columns_by_symbol
    recorded = next((part for part in model.result.recorded if part.name == beginning.name), None)
    is_same = recorded is not None and len(recorded.times) == len(simulation.t)
    columns = {names[state]: tuple(simulation[state].tolist()) for state in simulation.states}
    return Simulated(
        name=beginning.name or "1",
        times=tuple(simulation.t.tolist()),
        values={name: curve for name, curve in columns.items() if name in model.result.columns.states},
        start=dict(beginning.start),
        measured=dict(recorded.measured) if recorded is not None and is_same else {},
    )


def _trajectory(model: Model, part: Simulated) -> Mapping[str, Any]:
    curves, rows = curves_of(model, part), some(len(part.times), MOST_ROWS)
    lower, upper = (
        {name: _numbers(curve) for name, curve in side.items()} if side else None
        for side in (curves.lower, curves.upper)
    )
    return {
        "name": part.name,
        "held_out": part.held_out,
        "pieces": curves.pieces,
        "times": _numbers(curves.times, 12),
        "values": {name: _numbers(curve) for name, curve in curves.values.items()},
        "lower": lower,
        "upper": upper,
        "measured_times": _numbers((part.times[row] for row in rows), 12) if part.measured else [],
        "measured": {name: _numbers(curve[row] for row in rows) for name, curve in part.measured.items()},
    }


def _fitted_values(model: Model) -> Mapping[str, Any] | None:
    """Return measured and fitted values of a regression; None if the result has no such values."""
    known = model.result.regression
    if known is None or not known.measured:
        return None
    rows = some(len(known.measured), MOST_ROWS)
    variables = {name: np.array([values[row] for row in rows], dtype=float) for name, values in known.variables.items()}
    return {
        "target": model.result.columns.target,
        "measured": _numbers(known.measured[row] for row in rows),
        "fitted": _numbers(model.predict(variables).tolist()),
    }
