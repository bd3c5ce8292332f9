"""Does a model foretell what was not measured? All its equations are solved together from fresh initial conditions."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from scipy.integrate import solve_ivp

from atoll_core.data.dataset import FloatArray
from atoll_core.errors import UsageError
from atoll_core.expression.operators import (
    ABS,
    ADD,
    CONSTANT,
    COS,
    DIVIDE,
    EXP,
    INVERSE,
    LOG,
    MULTIPLY,
    NEGATE,
    POW,
    SIN,
    SQRT,
    SQUARE,
    SUBTRACT,
    TANH,
    VARIABLE,
)
from atoll_core.expression.text.parsing import from_infix
from benchmarks.noise.data import Path

GOOD_R2: Final = 0.9
"""A variable is foretold when its R² exceeds this."""

MAX_EVALUATIONS: Final = 50_000
LIMIT: Final = 1e8
"""States beyond this are a model that has run away."""

STEP: Final = 0.25
"""Largest step of the solver: a jump must not be stepped over."""

_FORMS: Final = {
    ADD: "{0} + {1}",
    SUBTRACT: "{0} - {1}",
    MULTIPLY: "{0} * {1}",
    DIVIDE: "{0} / {1}",
    POW: "pow({0}, {1})",
    SIN: "sin({0})",
    COS: "cos({0})",
    EXP: "exp({0})",
    LOG: "log({0})",
    SQRT: "sqrt({0})",
    ABS: "abs({0})",
    TANH: "tanh({0})",
    INVERSE: "1.0 / {0}",
    SQUARE: "{0} * {0}",
    NEGATE: "-{0}",
}
_NAMES: Final = {name: getattr(math, name) for name in ("sin", "cos", "exp", "log", "sqrt", "tanh", "pow")}


class _RunawayError(Exception):
    """Raised when a solution leaves the finite range or needs too many evaluations."""


Field = Callable[[Sequence[float]], list[float]]


def field_of(expressions: Sequence[str], names: Sequence[str]) -> Field:
    """Return the function from the values of `names` to those of `expressions`, as plain Python: one row at a time.

    Raises:
        UsageError: a text is no expression over `names`.
    """
    lines: list[str] = ["def slopes(values):"]
    results: list[str] = []
    for number, text in enumerate(expressions):
        program = from_infix(text, names)
        columns = (program.operators, program.left, program.right, program.constants)
        for index, (code, left, right, value) in enumerate(zip(*(column.tolist() for column in columns), strict=True)):
            arguments = (f"e{number}_{left}", f"e{number}_{right}")
            if code == VARIABLE:
                form = f"values[{left}]"
            else:
                form = repr(value) if code == CONSTANT else _FORMS[code].format(*arguments)
            lines.append(f"    e{number}_{index} = {form}")
        results.append(f"e{number}_{len(program) - 1}")
    lines.append(f"    return [{', '.join(results)}]")
    space: dict[str, Any] = {**_NAMES, "abs": abs, "inf": math.inf, "nan": math.nan}
    exec("\n".join(lines), space)  # made of operator codes and numbers only
    slopes: Field = space["slopes"]
    return slopes


def simulated(field: Field, path: Path, max_evaluations: int = MAX_EVALUATIONS) -> FloatArray | None:
    """Return the states (n, S) that `field` gives at the times of `path`, from where that begins.

    None when the solution does not reach the end: it runs away, or takes more than `max_evaluations`.
    """
    evaluations = 0

    def slope(_time: float, state: FloatArray) -> list[float]:
        nonlocal evaluations
        evaluations += 1
        values = state.tolist()
        if evaluations > max_evaluations or not all(abs(value) < LIMIT for value in values):
            raise _RunawayError
        return field(values)

    span = (float(path.times[0]), float(path.times[-1]))
    try:
        with np.errstate(all="ignore"):
            solution = solve_ivp(
                slope, span, path.states[0], method="LSODA", t_eval=path.times, rtol=1e-8, atol=1e-10, max_step=STEP
            )
    except (_RunawayError, ArithmeticError, ValueError):
        return None
    states = np.ascontiguousarray(solution.y.T)
    return states if solution.success and np.isfinite(states).all() else None


def r_squared(found: FloatArray, true: FloatArray) -> list[float]:
    """Return 1 - (sum of squared errors) / (sum of squares about the mean) of each column of (n, S) values."""
    errors = ((found - true) ** 2).sum(axis=0)
    spread = ((true - true.mean(axis=0)) ** 2).sum(axis=0)
    return [float(value) for value in 1.0 - errors / np.maximum(spread, 1e-300)]


def foretold(expressions: Mapping[str, str | None], names: Sequence[str], path: Path) -> dict[str, float | None]:
    """Return R² of each variable when the equations are solved along `path`, None where that is not possible.

    Args:
        expressions: right-hand sides by state, in the order of the states; None where there is no equation.
        names: variables of expressions, the states first.
        path: the true trajectory.
    """
    texts = list(expressions.values())
    if any(text is None for text in texts):
        return dict.fromkeys(expressions)
    try:
        states = simulated(field_of([text for text in texts if text], names), path)
    except UsageError:  # too long to be read back
        states = None
    if states is None:
        return dict.fromkeys(expressions)
    return dict(zip(expressions, r_squared(states, path.states), strict=True))


def is_foretold(r2: float | None) -> bool:
    """Tell whether an R² counts as foretold."""
    return r2 is not None and r2 > GOOD_R2
